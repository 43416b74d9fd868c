"""Groups of degrees of freedom: the bodies they move, their names, and how far they are searched."""

import numpy as np
from jaxtyping import Bool, Float, Int

from ._character import Character


def dominant_bodies(character: Character) -> Int[np.ndarray, "face"]:
    """The body that moves each face most."""
    return np.asarray(character.weights)[np.asarray(character.faces)].sum(1).argmax(1)


def group_bodies(character: Character, dofs: tuple[int, ...], outer: bool = False) -> Bool[np.ndarray, "body"]:
    """The bodies a group moves; with `outer` those beyond its elbow or knee."""
    skeleton = character.skeleton
    if min(dofs) < 6:
        return np.ones(len(skeleton.body_names), bool)
    hinges = [d for d in dofs if outer and any(part in skeleton.dof_names[d] for part in ("elbow", "knee"))]
    return np.asarray(skeleton.moved_by()[np.array(hinges or dofs) - 6].any(0))


def outer_halves(character: Character) -> list[Bool[np.ndarray, "body"]]:
    """The bodies beyond the elbow or knee of each limb, in the order of the skeleton's groups."""
    limbs = [dofs for name, dofs in character.skeleton.groups if name.endswith(("arm", "leg"))]
    return [group_bodies(character, dofs, outer=True) for dofs in limbs]


def initial_spread(character: Character) -> Float[np.ndarray, "dof"]:
    """Standard deviation of the first particles per DoF, metres and radians, for a subject that moves at 1 m/s."""
    degrees = {
        "clav": 4.0,
        "lumbar": 6.0,
        "thorax": 6.0,
        "neck": 6.0,
        "shoulder": 12.0,
        "hip": 12.0,
        "elbow": 15.0,
        "knee": 15.0,
    }
    spread = np.full(39, np.deg2rad(10.0))
    spread[:3], spread[3:6] = 0.04, np.deg2rad(6.0)
    for index, name in enumerate(character.skeleton.dof_names):
        for part, value in degrees.items():
            if part in name and index >= 6:
                spread[index] = np.deg2rad(value)
    return spread


def limb_names(character: Character) -> dict[str, str]:
    """What people call the limbs, by the name of their group of DOFs."""
    sides = {"l": "left", "r": "right"}
    limbs = [name for name, _ in character.skeleton.groups if name.endswith(("arm", "leg"))]
    return {name: f"{sides[name[0]]} {name.split('_')[-1]}" for name in limbs}
