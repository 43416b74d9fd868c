"""The actor in a file, skinned or not."""

from collections.abc import Callable
from pathlib import Path

from jaxmocap.character import Character

from ._keep_skin import brings_skin
from ._rig import rig


def open_actor(path: str | Path, say: Callable[[str], None] | None = None) -> Character:
    """The character in a skinned glTF file or body model, or a bare mesh rigged on the spot, which `say` is told about.

    Raises `InputError` as `Character.load` and `rig` do.
    """
    path = Path(path)
    if brings_skin(path):
        return Character.load(path)
    rigged = rig(path)
    if say is not None:
        report = rigged.report
        say(
            f"{path} has no skeleton and was rigged: {report['triangles']['after']:,} triangles, "
            f"{report['height_m']:.2f} m tall. `jaxmocap rig` keeps the result and draws it."
        )
        for warning in report["warnings"]:
            say(f"{path}: {warning}.")
    return rigged.character
