"""`jaxmocap read-motion`: a clip of another program as a result."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import tyro

from ._arguments import Json
from ._output import say, show


def read_motion(
    clip: Annotated[
        Path,
        tyro.conf.Positional,
        tyro.conf.arg(metavar="CLIP", help="A .bvh, .glb, .gltf or .vrm file."),
    ],
    out: Annotated[Path, tyro.conf.arg(metavar="DIR", help="New folder for the motion.")],
    actor: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="FILE.glb",
            help="Character that is to move.",
            help_behavior_hint="(default: the clip's own, which a BVH does not have)",
        ),
    ] = None,
    metres_per_unit: Annotated[
        float | None,
        tyro.conf.arg(
            metavar="F",
            help="The file's unit, such as 0.01.",
            help_behavior_hint="(default: legs become as long as the character's)",
        ),
    ] = None,
    animation: Annotated[
        str | None,
        tyro.conf.arg(metavar="NAME", help="Which of several animations.", help_behavior_hint="(default: the first)"),
    ] = None,
    mapping: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="FILE.toml",
            help="Lines of file joint = body, where joints are not recognised.",
            help_behavior_hint="",
        ),
    ] = None,
    json: Json = False,
) -> int:
    """Read a clip as a motion of a character, for evaluate and export."""
    from jaxmocap._files import claim_output
    from jaxmocap.importers import read_motion
    from jaxmocap.rigging import open_actor

    with claim_output(out) as staging:
        character = None if actor is None else open_actor(actor, say)
        motion = read_motion(clip, character, mapping=mapping, animation=animation, metres_per_unit=metres_per_unit)
        if actor is not None:
            motion = replace(motion, provenance={**motion.provenance, "actor": str(actor.resolve())})
        motion.save(staging)
    seconds = float(motion.timestamps[-1] - motion.timestamps[0])
    record = {"motion": out, "frames": len(motion), "seconds": round(seconds, 3), "up": motion.up}
    show(record, lambda: f"{out}: {len(motion)} frames, {seconds:.2f} s, {motion.up} up", json_wanted=json)
    return 0
