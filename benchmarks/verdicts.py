"""How often "trust" and "do not trust" are right: good captures, and ones that are wrong on purpose.

    python benchmarks/verdicts.py ../shared/data [--only plaza_late ...] [--quality draft] [--out FIGURES.json]

Copies of plaza and street, half as large, get a wrong focal length, swapped cameras, a camera that started 0.2 s late,
one that was pushed, one that stops, another person's mesh, or no second camera; or the tracker goes by optical flow
alone and drifts. Every copy is tracked over some frames. A frame is wrong where the mean error of its joints is above
8 cm: markers are bound to the mesh in the first frame, and where that is wrong they say the same of every later one. A
capture that is refused at once, with a sentence, counts as not trusted in every frame. Per case the table says how many
frames are right and wrong, and how many of each were told so. The verdict is fitted to other films (`verdict_fit.py`);
these were in sight when its features were chosen.
"""

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jaxmocap

jaxmocap.configure()

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
from figures import add_options, finish, record  # noqa: E402

from jaxmocap import InputError  # noqa: E402
from jaxmocap.metrics import Truth, joint_errors  # noqa: E402
from jaxmocap.motion import Motion  # noqa: E402
from jaxmocap.pipeline import track_capture  # noqa: E402

WRONG = 8.0
"""Centimetres."""


class Case(NamedTuple):
    """`make(data, folder)` writes a capture, of which `frames` are tracked."""

    make: Callable[[Path, Path], Path]
    frames: tuple[int, int]
    settings: dict[str, str] = {}  # noqa: RUF012


FLOW_ALONE = {"search": "off", "refine": "off"}
CASES = {
    "plaza": Case(lambda data, to: copied(data / "plaza", to), (50, 66)),
    "plaza_late": Case(lambda data, to: late_camera(data / "plaza", to), (50, 60)),
    "plaza_stopped": Case(lambda data, to: stopped_camera(data / "plaza", to, 54), (50, 66)),
    "plaza_focal": Case(lambda data, to: wrong_focal_length(data / "plaza", to, 1.2), (50, 58)),
    "plaza_flow": Case(lambda data, to: copied(data / "plaza", to), (50, 90), FLOW_ALONE),
    "plaza_actor": Case(lambda data, to: other_actor(data / "plaza", to, data / "street" / "actor.glb"), (50, 58)),
    "plaza_swapped": Case(lambda data, to: swapped_cameras(data / "plaza", to), (50, 56)),
    "plaza_turned": Case(lambda data, to: turned_camera(data / "plaza", to), (50, 58)),
    "plaza_alone": Case(lambda data, to: one_camera(data / "plaza", to), (50, 58)),
    "street": Case(lambda data, to: copied(data / "street", to), (0, 12)),
    "street_late": Case(lambda data, to: late_camera(data / "street", to), (0, 10)),
    "street_focal": Case(lambda data, to: wrong_focal_length(data / "street", to, 0.8), (0, 8)),
    "street_stopped": Case(lambda data, to: stopped_camera(data / "street", to, 20), (17, 33)),
    "street_actor": Case(lambda data, to: other_actor(data / "street", to, data / "plaza" / "actor.glb"), (0, 8)),
}


class Outcome(NamedTuple):
    """Per frame the mean error in centimetres (infinite where the capture was refused), and whether it is trusted."""

    errors: np.ndarray
    trusted: np.ndarray
    refused: str = ""


def errors_of(motion: Motion, truth: Path) -> np.ndarray:
    """Mean over the joints of every frame, centimetres."""
    reference, evaluated = Truth.read(truth).at(motion)
    assert reference.joints is not None
    return 100 * np.nanmean(joint_errors(evaluated, reference.joints, reference.joint_names).raw, axis=1)


def outcome(case: Case, data: Path, folder: Path, quality: str) -> Outcome:
    """Make a case, track it, and compare with the truth."""
    capture, out = case.make(data, folder / "capture"), folder / "result"
    try:
        motion = track_capture(
            capture,
            out,
            quality=quality,  # pyright: ignore[reportArgumentType]
            frames=case.frames,
            settings=case.settings,
            overlays=False,
        )
    except InputError as error:
        count = case.frames[1] - case.frames[0]
        return Outcome(np.full(count, np.inf), np.zeros(count, bool), str(error))
    return Outcome(errors_of(motion, capture / "truth.npz"), motion.status == "ok")


def shares(outcomes: list[Outcome]) -> dict[str, float]:
    """Of the frames that are right the share that is trusted, of those that are wrong the share that is not."""
    wrong = np.concatenate([found.errors for found in outcomes]) > WRONG
    trusted = np.concatenate([found.trusted for found in outcomes])
    known = {"right frames trusted": trusted[~wrong], "wrong frames not trusted": ~trusted[wrong]}
    return {name: float(values.mean()) for name, values in known.items() if len(values)}


def row(name: str, outcomes: list[Outcome]) -> str:
    """A line of the table."""
    wrong = np.concatenate([found.errors for found in outcomes]) > WRONG
    trusted = np.concatenate([found.trusted for found in outcomes])
    counts = [int((a & b).sum()) for a in (~wrong, wrong) for b in (trusted, ~trusted)]
    refused = "  refused" if outcomes[0].refused else ""
    return f"{name:16s}" + "".join(f"{count:9d}" for count in counts) + refused


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="the folder of example captures")
    parser.add_argument("--only", nargs="+", choices=sorted(CASES), help="some of the cases")
    parser.add_argument("--quality", default="draft")
    add_options(parser)
    options = parser.parse_args()
    done: dict[str, Outcome] = {}
    heads = ("right: trusted", "not", "wrong: trusted", "not")
    print(f"{'frames':16s}" + "".join(f"{head[-8:]:>9s}" for head in heads), flush=True)
    for name in options.only or CASES:
        with tempfile.TemporaryDirectory() as folder:
            done[name] = outcome(CASES[name], options.data, Path(folder), options.quality)
        print(row(name, [done[name]]), flush=True)
    print(row("all", list(done.values())))
    figures = [record(metric, share, "", 0.03, "higher") for metric, share in shares(list(done.values())).items()]
    return finish(figures, options, quality=options.quality)


if __name__ == "__main__":
    raise SystemExit(main())
