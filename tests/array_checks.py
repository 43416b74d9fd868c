"""Run-time checks of array annotations for the tests.

Shapes and kinds of arrays are what a static checker cannot see, so those are checked here, in every call a test makes.
Everything else in a signature is left to pyright.
"""

import dataclasses
import inspect
from collections.abc import Callable
from typing import Any, get_args

import jax
import jaxtyping
import numpy as np
from beartype import BeartypeConf, beartype
from jaxtyping import AbstractArray

_CHECK = beartype(conf=BeartypeConf(is_pep484_tower=True))
_CHECK_THEIR_OWN = {
    # These say in a sentence what is wrong with an array, and their tests read that sentence.
    "jaxmocap.motion._motion.Motion.__init__",
    "jaxmocap.metrics._markers.marker_error",
    "jaxmocap.metrics._surface.silhouette_iou",
    "jaxmocap.camera._cameras.project",
    "jaxmocap.camera._cameras.pixel_rays",
    "jaxmocap.camera._cameras.triangulate",
    "jaxmocap.camera._cameras.Cameras.__init__",
    "jaxmocap.character._pose.retract",
    "jaxmocap.energies._search_energy.score_particles",
    "jaxmocap.render._face_ids.face_ids",
    "jaxmocap.appearance._colour_model.psi",
    "jaxmocap.samplers._run.run",
    "jaxmocap.experiments._batched.SearchBatch.__call__",
    "jaxmocap.viewers._overlay.draw_overlay",
    "jaxmocap.pipeline._register_and_learn.fit_capture_appearance",
    "jaxmocap.registration._register.register",
    "jaxmocap.track._sequence.track",
}


def check_arrays(function: Callable[..., Any]) -> Callable[..., Any]:
    """A type checker for `jaxtyping.install_import_hook`, which calls it with copies of the functions to be checked."""
    if f"{function.__module__}.{function.__qualname__}" in _CHECK_THEIR_OWN:
        return function
    hints = function.__annotations__
    function.__annotations__ = {name: _or_numpy(hint) for name, hint in hints.items() if _holds_array(hint)}
    return _CHECK(function) if function.__annotations__ else function


def leave_alone_what_names_no_array() -> None:
    """Spare functions and records without an array in their annotations the import hook's wrapper: 1,700 of 2,700."""
    whole = jaxtyping.jaxtyped

    def jaxtyped(*args: Any, **options: Any) -> Any:
        if args:
            return whole(*args, **options)
        return lambda wrapped: whole(wrapped, **options) if _names_array(wrapped) else wrapped

    jaxtyping.jaxtyped = jaxtyped


def _names_array(wrapped: Any) -> bool:
    if isinstance(wrapped, property):
        return any(_names_array(part) for part in (wrapped.fget, wrapped.fset, wrapped.fdel) if part is not None)
    if inspect.isclass(wrapped):
        classes = wrapped.__mro__ if dataclasses.is_dataclass(wrapped) else ()
        hints = [hint for one in classes for hint in vars(one).get("__annotations__", {}).values()]
    else:
        hints = getattr(wrapped, "__func__", wrapped).__annotations__.values()
    return any(isinstance(hint, str) or _holds_array(hint) for hint in hints)


def _is_array(hint: Any) -> bool:
    return isinstance(hint, type) and issubclass(hint, AbstractArray)


def _holds_array(hint: Any) -> bool:
    """Whether an annotation speaks of an array with a shape, itself or inside a list, tuple, union and so on."""
    return _is_array(hint) or any(_holds_array(part) for part in get_args(hint))


def _or_numpy(hint: Any) -> Any:
    """What JAX does with an array it does with NumPy's too, so a test may pass either."""
    if _is_array(hint) and hint.array_type is jax.Array:
        kind = getattr(jaxtyping, hint.__name__.split("[")[0])
        return hint | kind[np.ndarray, hint.dim_str]
    return hint
