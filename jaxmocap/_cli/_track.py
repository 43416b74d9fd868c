"""`jaxmocap track`: a capture folder in, a result folder out."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from ._arguments import (
    ActorFile,
    CapturePath,
    DetectionsFolder,
    DetectionsFrames,
    FindMasks,
    FrameSpan,
    Height,
    Json,
    PoseFile,
    Preset,
    Seed,
    Settings,
    frame_span,
    named_settings,
)
from ._output import progress, say, show

if TYPE_CHECKING:
    from jaxmocap.motion import Motion

NOT_TRUSTED = 3


def track(
    capture: CapturePath,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR", help="New folder for the result.")],
    frames: FrameSpan = None,
    seed: Seed = 0,
    quality: Preset = "normal",
    polish: Annotated[
        bool, tyro.conf.arg(help_behavior_hint="", help="After each search, follow its energy downhill. Slow.")
    ] = False,
    settings: Settings = (),
    pose: PoseFile = None,
    find_masks: FindMasks = True,
    actor: ActorFile = None,
    height: Height = None,
    detections: DetectionsFolder = None,
    detections_frames: DetectionsFrames = None,
    overlays: Annotated[bool, tyro.conf.arg(help_behavior_hint="", help="Leave out the overlay videos.")] = True,
    resume: Annotated[
        bool, tyro.conf.arg(help_behavior_hint="", help="Go on with the unfinished run in DIR; the result is the same.")
    ] = False,
    cache: Annotated[
        bool,
        tyro.conf.arg(
            help_behavior_hint="", help="Do not take registration and appearance from an earlier run over the same."
        ),
    ] = True,
    json: Json = False,
) -> int:
    """Track the person through a capture and write the result. Exits with 3 if not every frame is to be trusted."""
    from jaxmocap.capture import Capture
    from jaxmocap.pipeline import track_capture

    changes = {"polish": "on"} if polish else {}
    spans = {"frames": frames, "detections-frames": detections_frames}
    length = Capture.open(capture).num_frames if any(spans.values()) else 0
    span, detected = (frame_span(text, length, f"--{name}") for name, text in spans.items())
    with progress() as report:
        motion = track_capture(
            capture,
            out,
            quality=quality,
            seed=seed,
            frames=span,
            pose_file=pose,
            actor=actor,
            height=height,
            settings=changes | named_settings(settings),
            overlays=overlays,
            progress=report,
            find_masks=find_masks,
            detections=detections,
            detections_frames=None if detected is None else range(*detected),
            say=say,
            resume=resume,
            cache=cache,
        )
    show({"out": out, **summary(motion)}, lambda: sentence(motion, out), json_wanted=json)
    return report_trust(motion)


def summary(motion: "Motion") -> dict[str, float]:
    """Sum up in numbers how a tracked motion turned out."""
    counts = {f"{status}_frames": int((motion.status == status).sum()) for status in ("lost", "doubtful")}
    counts = {"trusted_frames": int(motion.trusted.sum()), **counts}
    return {"frames": len(motion), **counts, "seconds_per_frame": motion.provenance["seconds_per_frame"]}


def sentence(motion: "Motion", out: Path) -> str:
    """Say in words how a tracked motion turned out."""
    found = summary(motion)
    return f"{out}: {counted(found)}, {found['seconds_per_frame']:.2f} s per frame; open {out / 'report.html'}"


def counted(found: dict[str, float]) -> str:
    """Count the frames of a `summary` in words: each is trusted, trusted but for a limb, lost or doubtful."""
    trusted, lost, doubtful = (found[f"{kind}_frames"] for kind in ("trusted", "lost", "doubtful"))
    partly = found["frames"] - trusted - lost - doubtful
    but_for_limb = f"{partly} but for a limb, " if partly else ""
    return f"{found['frames']} frames, {trusted} to be trusted, {but_for_limb}{lost} lost, {doubtful} doubtful"


def report_trust(motion: "Motion") -> int:
    """Name the frames that are not to be trusted, and why; the exit code."""
    from jaxmocap.camera import ranges

    def frames_by(spans: Iterable[dict[str, Any]], part: str) -> dict[tuple[str, str], str]:
        found: dict[tuple[str, str], list[int]] = {}
        for span in spans:
            found.setdefault((span.get(part, ""), span["why"]), []).extend(range(span["first"], span["last"] + 1))
        return {key: f"frame{'s' * (len(frames) > 1)} {ranges(frames)}" for key, frames in found.items()}

    record = motion.provenance
    limbs = [span for span in record["lost"] if span["part"] != "body"]
    for (limb, why), where in frames_by(limbs, "part").items():
        say(f"The {limb} is lost in {where}: {why}.")
    for (camera, why), where in frames_by(record["outlier_cameras"], "camera").items():
        say(f"Camera {camera} is left out of the verdict in {where}: {why}.")
    for (_, why), where in frames_by(record["doubts"], "").items():
        say(f"Do not trust {where}: {why}.")
    lost = motion.frames[motion.status == "lost"].tolist()
    if lost:
        say(f"Lost in frame{'s' if len(lost) > 1 else ''} {ranges(lost)}; the overlays show where.")
    return 0 if motion.trusted.all() else NOT_TRUSTED
