"""`jaxmocap body`: the built-in body as a file."""

from pathlib import Path
from typing import Annotated

import tyro

from jaxmocap._results import InputError

from ._arguments import Json
from ._output import show
from ._rig import refuse_unusable


def body(
    out: Annotated[Path, tyro.conf.arg(metavar="FILE.glb", help="New file for the body.")],
    height: Annotated[float, tyro.conf.arg(metavar="METRES", help="How tall it is.")] = 1.75,
    lengths: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="NAME=FACTOR ...",
            help="Longer or shorter: torso, shoulders, hips, head, upper_arm, forearm, hand, thigh, shank, foot.",
            help_behavior_hint="",
        ),
    ] = (),
    girths: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="NAME=FACTOR ...",
            help="Thicker or thinner: torso, head, upper_arm, forearm, hand, thigh, shank, foot.",
            help_behavior_hint="",
        ),
    ] = (),
    json: Json = False,
) -> int:
    """Write the built-in body, of any height and proportions, for fit-character or as an actor."""
    from jaxmocap.motion import atomic_path
    from jaxmocap.rigging import body

    refuse_unusable(out)
    character = body(height, _factors("--lengths", lengths), _factors("--girths", girths))
    out.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(out) as temporary:
        character.save_glb(temporary)
    record = {"out": out, "height_m": height, "triangles": len(character.faces)}
    show(record, lambda: f"{out}: {height:.2f} m tall, {len(character.faces)} triangles", json_wanted=json)
    return 0


def _factors(option: str, texts: tuple[str, ...]) -> dict[str, float]:
    found = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            raise InputError(f"{option} has {text!r}; NAME=FACTOR was expected, such as thigh=1.05.") from None
    return found
