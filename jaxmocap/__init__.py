"""jaxmocap: markerless motion capture of one person from two or three handheld videos.

    import jaxmocap as jm

    jm.configure()                                                   # before JAX starts: compiled programs are kept
    import jax

    key          = jax.random.key(0)
    capture      = jm.Capture.open("plaza")
    cameras      = capture.cameras
    character    = jm.Character.load(capture.actor)
    registered   = jm.register(capture, cameras, character, key=key)
    key_poses    = {frame: found.pose for frame, found in registered.items()}
    settings     = jm.appearance_preset("normal")
    appearance   = jm.fit_capture_appearance(capture, cameras, character, key_poses, key=key, settings=settings)
    observations = jm.observe(capture, cameras, character, appearance, key_poses)
    motion       = jm.track(observations, tracker=jm.Tracker.preset("normal"), key=key)
    motion.save("result")

What is public here is what a user of the pipeline names, in the order of the pipeline; `_public.py` is the list. A part
that one exchanges or builds with (an energy term, a sampler, a rasteriser) is public in its own package:
`jaxmocap.energies`, `jaxmocap.samplers` and so on. Modules that begin with an underscore may change without notice.

Importing this package imports nothing else: names are looked up when they are first used, each in its own package, so
that the command line answers at once and `configure` can act before JAX is imported.
"""

import ast
import importlib
import importlib.util
import sys
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from ._results import InputError as InputError
from ._runtime import configure as configure

if TYPE_CHECKING:
    from ._public import *  # noqa: F403

__version__ = "0.1.0"


_VERBS = ("scan", "track")
"""Functions that share their name with a package; as an attribute of this one it is the function."""


class _Package(ModuleType):
    """Leaves `_VERBS` to `__getattr__` when the packages of the same names are imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in _VERBS or not isinstance(value, ModuleType):
            super().__setattr__(name, value)


@cache
def _packages() -> dict[str, str]:
    """Read from `_public` of which package every public name is; to import that module would import them all."""
    tree = ast.parse(Path(__file__).with_name("_public.py").read_text())
    return {
        alias.asname or alias.name: f"{__name__}.{node.module}" if node.level else str(node.module)
        for node in tree.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }


def __getattr__(name: str) -> Any:
    if name.startswith("_"):
        raise AttributeError(f"module 'jaxmocap' has no attribute {name!r}")
    if name not in _VERBS and importlib.util.find_spec(f"jaxmocap.{name}") is not None:
        return importlib.import_module(f"jaxmocap.{name}")
    if name in _packages():
        return getattr(importlib.import_module(_packages()[name]), name)
    raise AttributeError(f"module 'jaxmocap' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_packages()})


sys.modules[__name__].__class__ = _Package
