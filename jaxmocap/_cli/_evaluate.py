"""`jaxmocap evaluate`: a result against the truth."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from jaxmocap._results import InputError

from ._arguments import Json
from ._output import show

if TYPE_CHECKING:
    from jaxmocap.motion import Motion


def evaluate(
    result: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR", help="Folder that track wrote.")],
    truth: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="truth.npz",
            help="True markers or joints.",
            help_behavior_hint="(default: the truth of the tracked capture)",
        ),
    ] = None,
    joints: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="comparable|all|NAME ...",
            help="Joints to score: neck, shoulders, elbows, wrists, hips, knees and ankles, which every rig puts in "
            "the same place; all of the skeleton; or these.",
        ),
    ] = ("comparable",),
    align: Annotated[
        Literal["cameras", "joints"],
        tyro.conf.arg(
            help="What brings the result's world to the truth's: the cameras, where the truth holds theirs; or the "
            "joints of all frames, for cameras that were calibrated from the videos alone.",
        ),
    ] = "cameras",
    json: Json = False,
) -> int:
    """Score a result by the paper's marker protocol and by joints, in centimetres."""
    from jaxmocap.metrics import evaluate, evaluation_table
    from jaxmocap.motion import Motion

    motion = Motion.load(result)
    chosen = joints[0] if joints in (("comparable",), ("all",)) else joints
    scores = evaluate(motion, truth or _truth_of(motion, result), joints=chosen, align=align)
    show(scores, lambda: evaluation_table(scores, f"{result}"), json_wanted=json)
    return 0


def _truth_of(motion: "Motion", result: Path) -> Path:
    """Find the truth of the capture that a motion was tracked in."""
    recorded = motion.provenance.get("truth")
    if not recorded:
        raise InputError(f"{result} was tracked in a capture without a truth; give one with --truth truth.npz.")
    if not Path(recorded).is_file():
        raise InputError(f"the truth {recorded} of {result} is no longer there; give one with --truth truth.npz.")
    return Path(recorded)
