"""Files that set single degrees of freedom at selected frames."""

import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from jaxmocap._results import InputError
from jaxmocap.character import ROOT_DOFS, Character, Pose, pose_from_vector, pose_vector

LARGEST_VALUE = 1e6
"""No metre or degree of a pose file is larger."""

Overrides = dict[int, dict[str, float]]
"""Frame -> DoF name -> value: metres for root translations, degrees for everything else."""


def apply_overrides(character: Character, pose: Pose, values: dict[str, float]) -> tuple[Pose, list[int]]:
    """Set single DoFs of a pose; return it with their indices.

    Raises `InputError` for a name the skeleton does not have.
    """
    skeleton = character.skeleton
    vector = np.array(pose_vector(skeleton, pose))
    indices = []
    for name, value in values.items():
        if name not in skeleton.dof_names:
            raise InputError(
                f"the pose file sets '{name}', which is no degree of freedom; the names are "
                f"{', '.join(skeleton.dof_names)}."
            )
        index = skeleton.dof_names.index(name)
        vector[index] = value if index < 3 else np.deg2rad(value)
        if index >= ROOT_DOFS:
            low, high = float(skeleton.lower[index - ROOT_DOFS]), float(skeleton.upper[index - ROOT_DOFS])
            if not low - 1e-6 <= vector[index] <= high + 1e-6:
                raise InputError(
                    f"the pose file sets {name} = {value:g} degrees, outside its limits "
                    f"{np.rad2deg(low):.0f} to {np.rad2deg(high):.0f}."
                )
        indices.append(index)
    return pose_from_vector(skeleton, jnp.asarray(vector, jnp.float32)), indices


def read_pose_file(path: str | Path) -> Overrides:
    """Read overrides from JSON: `{"0": {"root_ty": 0.1, "l_elbow_flex": 30}}`, frame -> DoF -> metres or degrees.

    Raises `InputError` for anything else.
    """
    if not Path(path).is_file():
        raise InputError(f"the pose file {path} does not exist.")
    try:
        raw = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"the pose file {path} cannot be read as JSON ({error}).") from error
    expected = f'the pose file {path} must map frames to degrees of freedom, like {{"0": {{"l_elbow_flex": 30}}}}'
    if not isinstance(raw, dict):
        raise InputError(f"{expected}; its top level is {type(raw).__name__}.")
    overrides: Overrides = {}
    for frame, values in raw.items():
        if not (frame.isascii() and frame.isdigit() and len(frame) < 10) or not isinstance(values, dict):
            raise InputError(f"{expected}; found the entry {frame[:40]!r}.")
        for name, value in values.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST_VALUE:
                raise InputError(
                    f"the pose file {path} gives {name} at frame {frame} the value "
                    f"{repr(value)[:40]}; a number is expected."
                )
        overrides[int(frame)] = {name: float(value) for name, value in values.items()}
    return overrides
