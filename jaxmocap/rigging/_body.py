"""The built-in body: nobody in particular, of any height, girth and length of limb."""

import math
from collections.abc import Mapping

import numpy as np

from jaxmocap._results import InputError
from jaxmocap.character import GIRTHS, LENGTHS, BodyShape, Character, scaled
from jaxmocap.synthetic import make_actor

_HEIGHTS, _SCALES = (0.5, 2.5), (0.5, 2.0)


def body(
    height: float = 1.75, lengths: Mapping[str, float] | None = None, girths: Mapping[str, float] | None = None
) -> Character:
    """A procedural body in an A-pose, about 4,900 triangles, free of any licence: a start for `fit_character`.

    It is `height` metres tall whatever its proportions. `lengths` and `girths` are factors by name (`LENGTHS`, `GIRTHS`
    of `jaxmocap.character`), such as `lengths={"thigh": 1.05}, girths={"torso": 1.2}`. Raises `InputError` for other
    names and for numbers that make no person.
    """
    if not _HEIGHTS[0] <= height <= _HEIGHTS[1]:
        raise InputError(f"height is {height:g} m; {_HEIGHTS[0]} to {_HEIGHTS[1]} m was expected.")
    shape = BodyShape.of(0.0, _logarithms("length", lengths, LENGTHS), _logarithms("girth", girths, GIRTHS))
    character = scaled(make_actor(height), shape)
    size = height / float(np.ptp(np.asarray(character.vertices)[:, 1]))
    return scaled(character, BodyShape.of(math.log(size)))


def _logarithms(kind: str, factors: Mapping[str, float] | None, names: tuple[str, ...]) -> dict[str, float]:
    for name, factor in (factors or {}).items():
        if name not in names:
            raise InputError(f"{name!r} has no {kind} that can be changed; use {', '.join(names)}.")
        if not _SCALES[0] <= factor <= _SCALES[1]:
            raise InputError(
                f"the {kind} of {name} is {factor:g}; a factor of {_SCALES[0]} to {_SCALES[1]} was expected."
            )
    return {name: math.log(factor) for name, factor in (factors or {}).items()}
