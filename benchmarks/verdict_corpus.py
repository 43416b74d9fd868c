"""Films that nobody tuned to: random synthetic captures, good ones and broken ones, each tracked once.

    python benchmarks/verdict_corpus.py CORPUS [--seeds 0:60] [--workers 2] [--real ../shared/data]

Every seed draws a film: routine, speed, a jump, the side from which the actor is seen, clothes, scenery, light, motion
blur, noise, compression, shake, angle and number of cameras, focal length, how large the actor is, somebody who walks
past behind, size, the actor's own mesh or a body made to measure, pixels alone or a detector's keypoints beside them.
It is tracked as it is, and with two of the mistakes of
`broken_captures.py`. Even seeds are for fitting, odd ones for judging (`half_of`). `--real` tracks the cases of
`verdicts.py` and real captures instead, which nothing is fitted to. Keypoints are those of `jaxmocap detect`, which
needs the extra `detect` and its weights. CORPUS/NAME.npz holds what the tracker saw and the errors of the joints; a run
that is there is not done again, and one that fails is told with its traceback and tried again by the next call.
"""

import argparse
import multiprocessing
import tempfile
import traceback
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jaxmocap

jaxmocap.configure()

import jax  # noqa: E402
import numpy as np  # noqa: E402
from broken_captures import (  # noqa: E402
    copied,
    late_camera,
    one_camera,
    other_actor,
    stopped_camera,
    swapped_cameras,
    turned_camera,
    wrong_focal_length,
)
from verdicts import CASES  # noqa: E402

from jaxmocap import InputError  # noqa: E402
from jaxmocap._cache import read_records, write_records  # noqa: E402
from jaxmocap.capture import Capture, Detections  # noqa: E402
from jaxmocap.character import Character, Pose  # noqa: E402
from jaxmocap.detection import write_person  # noqa: E402
from jaxmocap.geometry import so3_exp  # noqa: E402
from jaxmocap.metrics import Truth, joint_errors  # noqa: E402
from jaxmocap.motion import Motion  # noqa: E402
from jaxmocap.observation import observe  # noqa: E402
from jaxmocap.pipeline import character_of, detect, register_and_learn, with_selected_frames  # noqa: E402
from jaxmocap.refinement import DetectionPlan  # noqa: E402
from jaxmocap.registration import masks_of  # noqa: E402
from jaxmocap.synthetic import make_actor, make_capture, perform, write_capture  # noqa: E402
from jaxmocap.track import Tracker, track_frames, with_settings  # noqa: E402
from jaxmocap.verdict import FrameResult  # noqa: E402
from jaxmocap.viewers import open_video  # noqa: E402

NUM_FRAMES = 16
FLOW_ALONE = {"search": "off", "refine": "off"}


class Tracked(NamedTuple):
    """What a run left: the tracker's results (none where the capture was refused), what the verdict needs beside them,
    the true joints, the errors of those that are compared in metres, and how the capture was made."""

    name: str
    results: list[FrameResult]
    character: Character | None
    registered: tuple[int, ...]
    cameras: tuple[str, ...]
    truth: np.ndarray
    truth_names: tuple[str, ...]
    errors: np.ndarray
    joint_names: tuple[str, ...]
    about: dict[str, Any]


class Sample(NamedTuple):
    """A run: `make(folder)` writes a capture."""

    name: str
    make: Callable[[Path], Path]
    quality: str
    frames: tuple[int, int] | None
    settings: dict[str, str]
    about: dict[str, Any]


def half_of(name: str) -> str:
    """Whether a run is to fit on, to judge by, or real."""
    return "real" if not name[0].isdigit() else "fit" if int(name[:4]) % 2 == 0 else "judge"


MISTAKES = ("focal", "swapped", "turned", "late", "stopped", "actor", "flow", "alone")


def drawn_film(seed: int) -> dict[str, Any]:
    """Draw how a film is made; equal seeds give equal films."""
    rng = np.random.default_rng([seed, 36])

    def one_of(*values, p=None):
        return values[rng.choice(len(values), p=p)]

    film = {
        "routine": one_of("dance", "crossing arms", "bending arm", p=(0.6, 0.2, 0.2)),
        "speed": float(rng.uniform(0.6, 2.0)),
        "begin": float(rng.uniform(0, 20)),
        "jump": float(one_of(0.0, rng.uniform(0.1, 0.4), p=(0.6, 0.4))),
        "turn": float(
            one_of(rng.uniform(-40, 40), 180 + rng.uniform(-40, 40), rng.uniform(60, 120), p=(0.6, 0.25, 0.15))
        ),
        "height": float(rng.uniform(1.55, 1.95)),
        "clothes": one_of("patterned", "uniform", "plain sleeves", p=(0.5, 0.2, 0.3)),
        "scenery": one_of("bricks", "skin", p=(0.75, 0.25)),
        "size": one_of((512, 288), (640, 360), p=(0.3, 0.7)),
        "cameras": int(one_of(2, 3, p=(0.7, 0.3))),
        "degrees": float(rng.uniform(12, 50)),
        "shake": float(rng.uniform(0, 1.5)),
        "noise": float(rng.uniform(0.003, 0.02)),
        "light": float(one_of(0.0, rng.uniform(0.1, 0.35), p=(0.6, 0.4))),
        "sub_frames": int(one_of(1, 4)),
        "fps": float(one_of(15.0, 30.0)),
        "generic": bool(one_of(False, True, p=(0.8, 0.2))),
        "quality": one_of("draft", "normal", p=(0.8, 0.2)),
        "mistakes": (one_of(*MISTAKES),),
        "amount": float(rng.uniform(0, 1)),
        "selected": one_of((0,), (0, NUM_FRAMES // 2)),
    }
    others = [mistake for mistake in MISTAKES if mistake not in film["mistakes"]]
    film["mistakes"] = (*film["mistakes"], one_of(*others))
    film |= {"detections": bool(one_of(True, False, p=(0.6, 0.4))), "compression": int(rng.integers(10, 30))}
    if rng.random() < 0.3:
        film["degrees"] = float(rng.uniform(50, 110))
    return film | {
        "bystander": bool(one_of(True, False, p=(0.4, 0.6))),
        "focal": float(rng.uniform(0.7, 1.4)),
        "fraction": float(rng.uniform(0.5, 0.85)),
    }


def moving(film: dict[str, Any]) -> Motion:
    """Perform a film's motion: the routine at its speed, turned about the vertical, with a jump."""
    actor, count = make_actor(film["height"]), 4 * NUM_FRAMES
    moments = np.arange(count) / (2 * film["fps"])
    poses = perform(film["routine"], actor.skeleton, film["begin"] + film["speed"] * moments)
    root = np.array(poses.root)
    air = np.clip((moments * film["fps"] / NUM_FRAMES - 0.35) / 0.3, 0, 1)
    root[:, 1, 3] += 4 * film["jump"] * air * (1 - air)
    turn = np.eye(4)
    turn[:3, :3] = so3_exp(jax.numpy.array([0.0, np.radians(film["turn"]), 0.0]))
    root = (turn @ root).astype(np.float32)
    return Motion.from_poses(actor, Pose(jax.numpy.asarray(root), poses.angles), np.arange(count), moments)


def filmed(seed: int, folder: Path) -> Path:
    """Film a seed into a folder."""
    film = drawn_film(seed)
    capture = make_capture(
        NUM_FRAMES,
        film["size"],
        film["cameras"],
        seed,
        fps=film["fps"],
        height=film["height"],
        camera_shake=film["shake"],
        clothes=film["clothes"],
        scenery=film["scenery"],
        view_angle_degrees=film["degrees"],
        sensor_noise=film["noise"],
        illumination_change=film["light"],
        sub_frames=film["sub_frames"],
        supersampling=1,
        selected_frames=(0, 5, 10, 15) if film["generic"] else film["selected"],
        motion=moving(film),
        focal_per_width=film["focal"],
        body_fraction=film["fraction"],
        bystander=film["bystander"],
    )
    return write_capture(capture, folder)


def without_actor(folder: Path) -> Path:
    """Leave the actor out of a capture, so that a body is made to measure."""
    toml = folder / "capture.toml"
    toml.write_text("\n".join(line for line in toml.read_text().split("\n") if not line.startswith("actor")))
    return folder


def damaged(film: dict[str, Any], kind: str, source: Path, folder: Path) -> Path:
    """Copy a film with a mistake, or as it is: "good" and "flow", whose mistake is the tracker's."""
    amount = film["amount"]
    sign = 1 if amount > 0.5 else -1
    if kind == "focal":
        return wrong_focal_length(source, folder, 1 + sign * (0.1 + 0.2 * abs(2 * amount - 1)))
    if kind == "swapped":
        return swapped_cameras(source, folder)
    if kind == "turned":
        return turned_camera(source, folder, 1 + 3 * amount)
    if kind == "late":
        return late_camera(source, folder, round((0.1 + 0.2 * amount) * film["fps"]) / film["fps"])
    if kind == "stopped":
        return stopped_camera(source, folder, 5)
    if kind == "actor":
        make_actor(film["height"] * (1 + sign * (0.08 + 0.12 * amount))).save_glb(source.parent / "other.glb")
        return other_actor(source, folder, source.parent / "other.glb")
    return one_camera(source, folder) if kind == "alone" else copied(source, folder)


def compressed(folder: Path, factor: int) -> Path:
    """Compress a capture's videos again; `factor` is x264's constant rate factor."""
    capture = Capture.open(folder)
    for camera, video in enumerate(capture.videos):
        pictures = [capture.image(camera, frame) for frame in range(capture.num_frames)]
        with open_video(folder / "again.mp4", quality=factor) as writer:
            for frame, picture in enumerate(pictures):
                writer.write(frame / capture.fps, picture)
        (folder / "again.mp4").replace(video)
    return folder


def detected(capture: Capture, folder: Path) -> Detections:
    """Detect the person in all frames; raises `InputError` where that cannot be, and the film is refused."""
    folder.mkdir()
    for name, person in detect(capture).people.items():
        write_person(folder / f"{name}.json", person)
    return Detections.open(capture, folder)


def synthetic(name: str) -> Sample:
    """A seed's film as it is, or with one of its mistakes: "0007_good", "0007_turned"."""
    seed, kind = int(name[:4]), name[5:]
    film = drawn_film(seed)

    def make(folder: Path) -> Path:
        capture = damaged(film, kind, filmed(seed, folder / "film"), folder / "capture")
        compressed(capture, film["compression"])
        return without_actor(capture) if film["generic"] and kind != "actor" else capture

    settings = FLOW_ALONE if kind == "flow" else {}
    return Sample(name, make, film["quality"], None, settings, film | {"kind": kind})


def real(data: Path) -> list[Sample]:
    """The cases of `verdicts.py`, and real captures as users track them."""
    samples = [
        Sample(name, lambda to, case=case: case.make(data, to / "capture"), "draft", case.frames, case.settings, {})
        for name, case in CASES.items()
    ]
    spans = {"plaza": (0, 100), "street": (0, 35), "balance": (0, 60)}
    return samples + [
        Sample(
            f"{name}_{by}", lambda to, name=name: data / name, "normal", frames, {}, {"detections": by == "detections"}
        )
        for by in ("normal", "detections")
        for name, frames in spans.items()
    ]


def tracked(sample: Sample, folder: Path) -> Tracked:
    """Track a sample and compare its joints with the truth."""
    path = sample.make(folder)
    about = {"kind": sample.name, **sample.about}
    try:
        capture, key = Capture.open(path), jax.random.key(0)
        height = sample.about.get("height") if capture.actor is None else None
        character = character_of(capture, None, height, key=jax.random.fold_in(key, 5)).character
        capture, _ = with_selected_frames(capture, None, None)
        made = register_and_learn(capture, character, key, None, sample.quality, True)
        capture = capture.with_masks(masks_of(made.masks))
        points = detected(capture, folder / "detected") if sample.about.get("detections") else None
        observations = observe(capture, capture.cameras, character, made.appearance, made.registrations, points)
        tracker = Tracker.preset(sample.quality)
        if points is not None:
            tracker = replace(tracker, detections=DetectionPlan())
        tracker = with_settings(tracker, sample.settings)
        results = track_frames(observations, tracker, key=jax.random.fold_in(key, 3), frames=sample.frames)
    except InputError as error:
        nothing = np.zeros((0, 0))
        about["refused"] = str(error)
        return Tracked(sample.name, [], None, (), (), nothing, (), nothing, (), about)
    positions = np.array([result.frame for result in results])
    poses = jax.tree.map(lambda *leaves: jax.numpy.stack(leaves), *(result.pose for result in results))
    numbers, moments = capture.video_frames[0][positions], capture.timestamps[positions]
    motion = Motion.from_poses(character, poses, numbers, moments)
    truth, evaluated = Truth.read(capture.truth).at(motion)
    errors = joint_errors(evaluated, truth.joints, truth.joint_names)
    chosen = tuple(observations.key_poses)
    return Tracked(
        sample.name,
        results,
        character,
        chosen,
        capture.camera_names,
        np.asarray(truth.joints),
        tuple(truth.joint_names),
        errors.raw,
        errors.names,
        about,
    )


def work(task: tuple[str, Path | None, Path]) -> str:
    """Do the run of a name, if it is not done; real ones are of the captures in a folder."""
    name, data, out = task
    file = out / f"{name}.npz"
    if file.is_file():
        return f"{name}: done before"
    sample = synthetic(name) if data is None else next(one for one in real(data) if one.name == name)
    try:
        with tempfile.TemporaryDirectory() as folder:
            found = tracked(sample, Path(folder))
    except Exception:
        return f"{sample.name}: {traceback.format_exc()}"
    write_records(file, found._asdict())
    if not found.results:
        return f"{sample.name}: refused, {found.about['refused']}"
    frame = 100 * np.nanmean(found.errors, axis=1)
    return f"{sample.name}: {frame.mean():.1f} cm, {int((frame > 8).sum())} of {len(frame)} frames wrong"


def read_run(file: Path) -> Tracked:
    """Read what a run left."""
    return Tracked(**read_records(file))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("corpus", type=Path)
    parser.add_argument("--seeds", default="0:60", help="A:B")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--real", type=Path, help="the folder of example captures")
    options = parser.parse_args()
    options.corpus.mkdir(parents=True, exist_ok=True)
    first, stop = map(int, options.seeds.split(":"))
    names = [f"{seed:04d}_{kind}" for seed in range(first, stop) for kind in ("good", *drawn_film(seed)["mistakes"])]
    if options.real is not None:
        names = [sample.name for sample in real(options.real)]
    tasks = [(name, options.real, options.corpus) for name in names]
    with multiprocessing.get_context("spawn").Pool(options.workers, maxtasksperchild=12) as pool:
        for number, line in enumerate(pool.imap_unordered(work, tasks), 1):
            print(f"[{number}/{len(tasks)}] {line}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
