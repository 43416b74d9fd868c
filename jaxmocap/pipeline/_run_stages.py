"""The stages of a run in their order: what each is made of, what it writes into `capture.toml`, and what can fail."""

from collections.abc import Callable
from typing import Any, NamedTuple

from jaxmocap._results import InputError

from ._run_footage import NotDetected
from ._run_work import RunWork

_HINTS = {
    "--method": "jaxmocap sync {capture} --method",
    "calibrate with --key-step 2": "run jaxmocap calibrate {capture} --replace --key-step 2",
    "try --key-step 2": "try jaxmocap calibrate {capture} --replace --key-step 2",
    "another --seed or --key-step": "another --seed",
    "choose --frames in which the person is whole and not too small, or leave the camera out with --cameras": "cut the "
    "video to where the person is whole and not too small, or leave it out",
    "give it with --up": "give it with jaxmocap calibrate {capture} --replace --up X Y Z",
    " with --pose": " with jaxmocap track {capture} --pose FILE --out DIR",
    " with --resume": "",  # a run goes on by itself
}
"""What messages of the verbs say, and how a run says it, which has not all of their options."""


class Stage(NamedTuple):
    """One stage of a run.

    Attributes:
        name: as messages call it.
        what: it does, in a few words.
        line: of `capture.toml` that it sets; None where it sets none.
        inputs: what it is made of now; may only be asked once the stages before are done.
        do: does it, and returns what it wrote, as JSON knows it.
        advice: what to do where it fails.
    """

    name: str
    what: str
    line: str | None
    inputs: Callable[[], Any]
    do: Callable[[], Any]
    advice: str


def stages_of(work: RunWork) -> list[Stage]:
    """List the stages in their order."""
    found = [
        Stage(
            "capture",
            "make a capture folder of the videos",
            None,
            lambda: work.videos,
            work.make_capture,
            "choose another folder with --out",
        )
    ]
    if work.several:
        found.append(
            Stage(
                "synchronise",
                "take the offsets given" if work.options.offset else "find when each video began",
                "offset",
                work.of_synchronise,
                work.synchronise,
                f"find a moment that both videos show, such as a foot that touches the ground, and say by how many "
                f"seconds a video's own time is to be moved with --offset {work.names[-1]}=SECONDS (0 if they began "
                "together)",
            )
        )
    detect = Stage(
        "detect",
        "take the keypoints given" if work.options.keypoints else "find the person's keypoints",
        "keypoints",
        work.of_detect,
        work.detect,
        "correct the files, or leave --keypoints out, and the person is looked for"
        if work.options.keypoints
        else "say where the person is in the first picture that all videos share with --person CAMERA=X,Y, or give "
        "another detector's files with --keypoints DIR",
    )
    calibrate = Stage(
        "calibrate",
        "find the cameras" if work.several else "assume a camera that stands still",
        "cameras",
        work.of_calibrate,
        work.calibrate if work.several else work.one_camera,
        "leave out a video that shows another place, say --static where all phones stood still, or give cameras of "
        f"your own (jaxmocap cameras {work.folder} --from FILE)"
        if work.several
        else f"give a camera of your own (jaxmocap cameras {work.folder} --from FILE)",
    )
    make = "scan the person" if work.options.scan else "make a body to the person's measure"
    body = Stage(
        "body",
        "take the actor" if work.options.actor else make,
        "actor",
        work.of_body,
        work.body,
        "give a scan or a character of the person with --actor FILE",
    )
    first = work.options.body_first  # and its bones tell the scale
    middle = [body, detect, calibrate] if first else [detect, calibrate, body]
    found += [
        *middle,
        Stage(
            "selected frames",
            "choose the frames that colours and poses begin with",
            "selected_frames",
            work.of_select,
            work.select,
            f"write selected_frames = [N, ...] into {work.folder}/capture.toml",
        ),
        Stage(
            "track",
            "track the person and write the report",
            None,
            work.of_track,
            work.track,
            f"look at the poses it begins with: jaxmocap register {work.folder} --out registered",
        ),
    ]
    return found


def in_a_run(sentence: str, work: RunWork) -> str:
    """Say a sentence of another verb so that it is true of a run; cameras that are calibrated again keep its scale."""
    for hint, instead in _HINTS.items():
        sentence = sentence.replace(hint, instead.format(capture=work.folder))
    height, distance = work.options.height, work.options.camera_distance
    calibrate = f"jaxmocap calibrate {work.folder} --replace"
    scale = "" if height is None else f" --height {height:g}"
    scale = scale if distance is None else f" --camera-distance {distance:g}"
    return sentence.replace(calibrate, calibrate + scale)


def do_stage(work: RunWork, stage: Stage) -> Any:
    """Do a stage, and return what it wrote.

    Raises `InputError`, which says which stage it was and what can be done.
    """
    try:
        return stage.do()
    except InputError as error:
        failed = stage
        if isinstance(error, NotDetected):
            failed = next(one for one in stages_of(work) if one.name == "detect")
        kept = f"; what was done before is kept in {work.folder}, and the same command goes on from there"
        kept = kept if work.folder.is_dir() else ""
        why = in_a_run(str(error), work).rstrip(".")
        raise InputError(f"stage '{failed.name}' failed: {why}. What you can do: {failed.advice}{kept}.") from error


def written(work: RunWork, stage: Stage) -> Any:
    """Read what `capture.toml` says in the stage's line now; None without it."""
    if stage.line is None or not (work.folder / "capture.toml").is_file():
        return None
    config = work.config()
    if stage.line == "offset":
        given = any("offset" in camera.model_fields_set for camera in config.camera)
        return [camera.offset for camera in config.camera] if given else None
    return getattr(config, stage.line)
