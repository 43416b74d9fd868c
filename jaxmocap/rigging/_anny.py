"""Anny (Bregier et al. 2025), a parametric body whose package the user installs: its skin with given phenotypes.

Its code is under Apache-2.0, MakeHuman's meshes in it are CC0. Only the default rig and mesh are used, which lie in the
package: nothing is downloaded.
"""

import importlib
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from scipy.optimize import root_scalar

from jaxmocap._results import InputError
from jaxmocap.character import RawSkin


class Anny:
    """The body as a source of joints: what is wrong is said in its name."""

    path = Path("Anny")

    def fail(self, message: str) -> NoReturn:
        """Raise the one-sentence error of this model."""
        raise InputError(f"Anny's body {message}.")


def anny_skin(parameters: Mapping[str, float], height: float | None) -> RawSkin:
    """Make the rest pose of the body from some of Anny's own `parameters`, or standing `height` metres tall.

    The parameters are gender, age, muscle, weight, height and proportions, each 0 to 1, 0.5 where not given; a man is
    gender 0, a young adult age 0.67. With `height` in metres, Anny's parameter of that name is chosen to match.

    Raises `InputError` where the package is missing, for other parameters, and for a height that they do not reach.
    """
    model = _model()
    chosen = _checked(parameters, tuple(model.phenotype_labels))
    if height is not None:
        if "height" in chosen:
            raise InputError("both a height in metres and Anny's own parameter height are given; give one of them.")
        chosen["height"] = _parameter_of_height(model, chosen, height)
    rest = model(phenotype_kwargs=chosen)
    vertices = np.asarray(rest["rest_vertices"][0], np.float64)
    count = len(model.bone_labels)
    weights = np.zeros((len(vertices), count))
    rows = np.arange(len(vertices))[:, None]
    np.add.at(weights, (rows, np.asarray(model.vertex_bone_indices)), np.asarray(model.vertex_bone_weights, np.float64))
    return RawSkin(
        vertices=vertices,
        faces=np.asarray(model.get_triangular_faces(), np.int64),
        weights=weights,
        joint_names=tuple(model.bone_labels),
        joint_parents=tuple(int(parent) for parent in model.bone_parents),
        joint_places=np.asarray(rest["rest_bone_heads"][0], np.float64),
        extras={},
        joint_nodes=tuple(range(count)),
        place=np.eye(4),
        inverse_binds=np.tile(np.eye(4), (count, 1, 1)),
    )


@lru_cache(maxsize=1)
def _model() -> Any:
    try:
        package = importlib.import_module("anny")
    except ImportError as error:
        raise InputError(
            f"the body model Anny cannot be imported ({error}); install it with: pip install 'jaxmocap[bodies]'."
        ) from None
    try:
        return package.Anny(skinning_method="lbs", phenotype_blendshapes="original")
    except (AttributeError, TypeError) as error:
        raise InputError(
            f"the installed version of Anny has another interface ({error}); install the one that is known with: "
            "pip install 'jaxmocap[bodies]'."
        ) from None


def _checked(parameters: Mapping[str, float], known: tuple[str, ...]) -> dict[str, float]:
    for name, value in parameters.items():
        if name not in known:
            raise InputError(f"{name!r} is no parameter of Anny; use {', '.join(known)}.")
        if not 0.0 <= value <= 1.0:
            raise InputError(f"Anny's parameter {name} is {value:g}; 0 to 1 was expected.")
    return {name: float(value) for name, value in parameters.items()}


def _parameter_of_height(model: Any, chosen: Mapping[str, float], height: float) -> float:
    def too_tall(parameter: float) -> float:
        rest = model(phenotype_kwargs={**chosen, "height": parameter})
        return float(np.ptp(np.asarray(rest["rest_vertices"][0])[:, 2])) - height  # z is up

    low, high = too_tall(0.0), too_tall(1.0)
    if low > 0 or high < 0:
        raise InputError(
            f"Anny's body with these parameters is {height + low:.2f} to {height + high:.2f} m tall; a height of "
            f"{height:g} m is not among them."
        )
    return float(root_scalar(too_tall, bracket=(0.0, 1.0), xtol=1e-4).root)
