"""Claiming a folder for the result of one run."""

import contextlib
import os
import re
import shutil
import tempfile
from collections.abc import Collection, Iterator
from pathlib import Path

from jaxmocap._results import InputError

_MOTION = "motion.npz"
_STAGING = ".partial-"
_CLUTTER = re.compile(r"\.DS_Store|\._.*|Thumbs\.db|desktop\.ini|\..*\.partial\..*", re.IGNORECASE)


def is_clutter(name: str) -> bool:
    """Tell whether nobody put a file of this name there: a file manager did, or we are about to rename it."""
    return _CLUTTER.fullmatch(name) is not None


@contextlib.contextmanager
def claim_output(
    path: str | os.PathLike[str], *, overwrite: bool = False, keep: tuple[str, ...] = ()
) -> Iterator[Path]:
    """Claim `path` for the result of one run; yields a staging folder inside it to write every file into.

    When the block ends well, the files move to `path`, `motion.npz` last, so that a `motion.npz` says that the result
    is whole; what came to `path` meanwhile is refused only where a file would replace it. When it raises, the staging
    folder is deleted, and `path` too if it was created here and is empty.

    Raises `InputError` if `path` is a file, holds the result of another run, or holds files that no run of ours wrote.
    `overwrite=True` replaces an earlier result, never foreign files. `keep` names files that may lie in `path` already,
    a checkpoint for example; they are left alone.
    """
    path = Path(path)
    check_output(path, overwrite=overwrite, keep=keep)
    created = not path.exists()
    try:
        path.mkdir(parents=True, exist_ok=True)
        staging = Path(tempfile.mkdtemp(prefix=_STAGING, dir=path))
    except OSError as error:
        raise InputError(
            f"The output folder {path} cannot be written ({error.strerror}); choose another with --out."
        ) from error
    try:
        yield staging
        names = os.listdir(staging) if staging.is_dir() else ()  # another run that ended here deletes it
        check_output(path, overwrite=overwrite, keep=keep, names=names)
        _publish(staging, path)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
        if created:
            with contextlib.suppress(OSError):
                path.rmdir()


def check_output(
    path: Path, *, overwrite: bool = False, keep: tuple[str, ...] = (), names: Collection[str] | None = None
) -> None:
    """Raise the `InputError` that `claim_output` would raise for a folder that is taken.

    Foreign files that file managers leave are let be; where `names` is given, all that are called otherwise.
    """
    if not path.exists():
        return
    if not path.is_dir():
        raise InputError(f"The output {path} is a file; a folder was expected, choose another with --out.")
    found = sorted(entry.name for entry in path.iterdir() if not is_clutter(entry.name))
    is_result = _MOTION in found
    if is_result and not overwrite:
        raise InputError(f"The folder {path} already holds the result of another run; choose another, or delete it.")
    foreign = [name for name in found if name not in keep and not name.startswith(_STAGING)]
    if names is not None:
        foreign = [name for name in foreign if name in names]
    if foreign and not is_result:
        raise InputError(
            f"The output folder {path} holds files that are not a result ({foreign[0]} and {len(foreign) - 1} more); "
            "choose an empty or a new folder."
        )


def _publish(staging: Path, path: Path) -> None:
    """Move every file from `staging` to `path`: the old `motion.npz` goes first, the new one comes last."""
    (path / _MOTION).unlink(missing_ok=True)
    for entry in sorted(staging.iterdir(), key=lambda entry: entry.name == _MOTION):
        target = path / entry.name
        if target.is_dir() and not target.is_symlink():
            shutil.rmtree(target)
        os.replace(entry, target)
    for leftover in path.glob(f"{_STAGING}*"):
        shutil.rmtree(leftover, ignore_errors=True)


def free_name(parent: Path, stem: str, suffix: str = "") -> Path:
    """Choose a path that does not exist: `cameras`, or the first of `cameras-2`, `cameras-3`, ..."""
    number, path = 1, parent / f"{stem}{suffix}"
    while path.exists():
        number += 1
        path = parent / f"{stem}-{number}{suffix}"
    return path
