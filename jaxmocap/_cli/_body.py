"""`jaxmocap body`: a body of a model as a file."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from ._arguments import Json, named_numbers
from ._output import show
from ._rig import refuse_unusable


def body(
    out: Annotated[Path, tyro.conf.arg(metavar="FILE.glb", help="New file for the body.")],
    height: Annotated[
        float | None,
        tyro.conf.arg(
            metavar="METRES",
            help="How tall it is.",
            help_behavior_hint="(default: 1.75, or what the parameters make)",
        ),
    ] = None,
    model: Annotated[
        Literal["built-in", "anny", "mhr"],
        tyro.conf.arg(help="Whose body: ours, Anny's (pip install 'jaxmocap[bodies]'), or MHR's (--assets)."),
    ] = "built-in",
    parameters: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="NAME=VALUE ...",
            help="Anny's, 0 to 1: gender, age, muscle, weight, height, proportions; or MHR's, shape0 to shape44.",
            help_behavior_hint="",
        ),
    ] = (),
    assets: Annotated[
        Path | None,
        tyro.conf.arg(metavar="DIR", help="MHR's rig.npz and lod1.npz, which you download.", help_behavior_hint=""),
    ] = None,
    triangles: Annotated[
        int, tyro.conf.arg(metavar="N", help="Simplify Anny's and MHR's body to about so many triangles.")
    ] = 5000,
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
    """Write a body of any size, the built-in one, Anny's or MHR's, for fit-character or as an actor."""
    from jaxmocap._files import atomic_path
    from jaxmocap.character import stature
    from jaxmocap.rigging import body

    refuse_unusable(out)
    character = body(
        height,
        named_numbers(lengths, "--lengths", "NAME=FACTOR", "thigh=1.05"),
        named_numbers(girths, "--girths", "NAME=FACTOR", "torso=1.1"),
        model=model,
        parameters=named_numbers(parameters, "--parameters", "NAME=VALUE", "weight=0.7"),
        assets=assets,
        num_faces=triangles,
    )
    tall = round(float(stature(character)), 4)
    with atomic_path(out) as temporary:
        character.save_glb(temporary)
    record = {"out": out, "model": model, "height_m": tall, "triangles": len(character.faces)}
    show(record, lambda: f"{out}: {tall:.2f} m tall, {len(character.faces)} triangles", json_wanted=json)
    return 0
