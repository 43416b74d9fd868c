"""The folder of a run: one process at a time, a checkpoint while it lasts, a whole result at its end."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from jaxmocap._files import check_output, claim_output
from jaxmocap._results import InputError
from jaxmocap.track import Checkpoint

_CHECKPOINT, _LOCK = "checkpoint", "lock"


class RunFolder(NamedTuple):
    """Where the files of the result are written, and where the unfinished run is kept."""

    staging: Path
    checkpoint: Path


def finished(out: Path) -> bool:
    """Whether the folder holds a result."""
    return (out / "motion.npz").is_file()


@contextlib.contextmanager
def run_folder(out: Path, *, resume: bool = False) -> Iterator[RunFolder]:
    """Claim `out` for a run. When the block ends well the files of `staging` move there and the checkpoint is deleted;
    when it raises, or the process dies, the checkpoint stays, if one was written.

    Raises `InputError` if another process is at work in `out`, if it holds anything but an unfinished run of ours, or
    if it holds one and `resume` is off.
    """
    checkpoint = out / _CHECKPOINT
    unfinished = Checkpoint(checkpoint).exists and not finished(out)
    if unfinished and not resume and not _held(checkpoint / _LOCK):
        raise InputError(
            f"the folder {out} holds an unfinished run; go on with --resume (resume=True), choose another folder, or "
            "delete it."
        )
    keep = tuple(entry.name for entry in out.iterdir()) if unfinished else (_CHECKPOINT,)
    check_output(out, keep=keep)
    created = not out.exists()
    try:
        with _only_run(checkpoint, out):
            with claim_output(out, keep=keep) as staging:
                yield RunFolder(staging, checkpoint)
            Checkpoint(checkpoint).remove()
    finally:
        if created:
            with contextlib.suppress(OSError):
                out.rmdir()


@contextlib.contextmanager
def _only_run(folder: Path, out: Path) -> Iterator[None]:
    """Hold a folder, which is made if need be, for this process. The system lets go when a process dies, however it
    dies; an empty folder is taken away at the end."""
    path = folder / _LOCK
    try:
        while True:
            folder.mkdir(parents=True, exist_ok=True)
            handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
            if not _locked(handle):
                os.close(handle)
                raise InputError(f"another run is writing to {out}; wait until it has ended, or choose another folder.")
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(handle), path.stat()):
                    break
            os.close(handle)  # the run that held it has ended in between, and has taken its file away
    except OSError as error:
        raise InputError(
            f"The output folder {out} cannot be written ({error.strerror or error}); choose another with --out."
        ) from error
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink()
        os.close(handle)
        with contextlib.suppress(OSError):
            folder.rmdir()


def _held(path: Path) -> bool:
    """Whether a living process holds a lock."""
    if not path.is_file():
        return False
    handle = os.open(path, os.O_RDWR)
    try:
        return not _locked(handle)
    finally:
        os.close(handle)


def _locked(handle: int) -> bool:
    """Lock an open file, if nobody else has."""
    try:
        if os.name == "posix":
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        else:
            import msvcrt

            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # pyright: ignore[reportAttributeAccessIssue]
    except OSError:
        return False
    return True
