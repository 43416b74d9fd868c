"""Bodies to start from: the built-in one, nobody in particular, and those of packages that the user installs."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from jaxmocap._results import InputError
from jaxmocap.character import GIRTHS, LENGTHS, BodyShape, Character, scaled, simplify, stature
from jaxmocap.synthetic import make_actor

from ._anny import Anny, anny_skin
from ._mhr import Mhr

BodyName = Literal["built-in", "anny", "mhr"]

_HEIGHTS, _SCALES = (0.5, 2.5), (0.5, 2.0)
_HEIGHT = 1.75  # of the built-in body
_FEWEST = 300  # triangles


def body(
    height: float | None = None,
    lengths: Mapping[str, float] | None = None,
    girths: Mapping[str, float] | None = None,
    *,
    model: BodyName = "built-in",
    parameters: Mapping[str, float] | None = None,
    assets: str | Path | None = None,
    num_faces: int = 5000,
) -> Character:
    """Make a body in an A-pose, a start for `fit_character`, or an actor as it is.

    It is `height` metres tall whatever its proportions. `lengths` and `girths` are factors by name (`LENGTHS`, `GIRTHS`
    of `jaxmocap.character`), such as `lengths={"thigh": 1.05}, girths={"torso": 1.2}`.

    The `model` "built-in" is a procedural body of about 4,900 triangles and 1.75 m, free of any licence. "anny" is that
    of the package `anny` (extra `bodies`; Bregier et al. 2025; Apache-2.0, meshes CC0) with its own `parameters`
    gender, age, muscle, weight, height and proportions, 0 to 1 (0.5 where not given): its skin and weights, simplified
    to about `num_faces` triangles, on our joints. "mhr" is the Momentum Human Rig (Ferguson et al. 2025; Apache-2.0) in
    the same way, from its tensor files in the folder `assets`, which you download; its parameters are "shape0" to
    "shape44", standard deviations. Raises `InputError` for other names, for numbers that make no person, and where
    package or files are missing.
    """
    if height is not None:
        check_height(height)
    shape = BodyShape.of(0.0, _logarithms("length", lengths, LENGTHS), _logarithms("girth", girths, GIRTHS))
    if num_faces < _FEWEST:
        raise InputError(f"{num_faces} triangles were asked for; at least {_FEWEST} make a person.")
    if assets is not None and model != "mhr":
        raise InputError(f"a folder of files is given, which the model {model} does not use; it is for mhr.")
    if model == "anny":
        skin = anny_skin(parameters or {}, height)
        plain = simplify(Character.from_skin("anny", Anny(), skin), num_faces)[0]
    elif model == "mhr":
        source = Mhr(assets)
        plain = simplify(Character.from_skin("mhr", source, source.skin(parameters or {})), num_faces)[0]
    elif model == "built-in":
        if parameters:
            raise InputError("the built-in body has no parameters; change it with lengths and girths.")
        height = _HEIGHT if height is None else height
        plain = make_actor(height)
    else:
        raise InputError(f"{model!r} is no body model; use built-in, anny or mhr.")
    wanted = float(stature(plain)) if height is None else height
    character = scaled(plain, shape)
    return scaled(character, BodyShape.of(math.log(wanted / float(stature(character)))))


def check_height(height: float) -> None:
    """Raise `InputError` for a height in metres that no person has."""
    if not _HEIGHTS[0] <= height <= _HEIGHTS[1]:
        raise InputError(f"height is {height:g} m; {_HEIGHTS[0]} to {_HEIGHTS[1]} m was expected.")


def _logarithms(kind: str, factors: Mapping[str, float] | None, names: tuple[str, ...]) -> dict[str, float]:
    for name, factor in (factors or {}).items():
        if name not in names:
            raise InputError(f"{name!r} has no {kind} that can be changed; use {', '.join(names)}.")
        if not _SCALES[0] <= factor <= _SCALES[1]:
            raise InputError(
                f"the {kind} of {name} is {factor:g}; a factor of {_SCALES[0]} to {_SCALES[1]} was expected."
            )
    return {name: math.log(factor) for name, factor in (factors or {}).items()}
