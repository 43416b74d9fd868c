"""The folder of a run: one process at a time, a checkpoint while it lasts, a whole result at its end."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from filelock import FileLock, Timeout

from jaxmocap._files import check_output, claim_output
from jaxmocap._results import InputError
from jaxmocap.track import Checkpoint

_CHECKPOINT, LOCK = "checkpoint", "lock"
_PATIENCE = 0.2  # seconds; a run that ends takes its lock file away, and a lock of that file is tried again


class RunFolder(NamedTuple):
    """The places of a run.

    Attributes:
        staging: where the files of the result are written.
        checkpoint: where the unfinished run is kept.
    """

    staging: Path
    checkpoint: Path


def finished(out: Path) -> bool:
    """Tell whether the folder holds a result."""
    return (out / "motion.npz").is_file()


def unfinished(out: Path) -> bool:
    """Tell whether the folder holds a run that can be gone on with."""
    return Checkpoint(out / _CHECKPOINT).exists and not finished(out)


def refuse_foreign(out: Path) -> tuple[str, ...]:
    """Raise `InputError` if `out` holds anything but an unfinished run; return the names of what may stay there."""
    keep = tuple(entry.name for entry in out.iterdir()) if unfinished(out) else (_CHECKPOINT,)
    check_output(out, keep=keep)
    return keep


@contextlib.contextmanager
def run_folder(out: Path, *, resume: bool = False) -> Iterator[RunFolder]:
    """Claim `out` for a run.

    When the block ends well the files of `staging` move there and the checkpoint is deleted; when it raises, or the
    process dies, the checkpoint stays, if one was written.

    Raises `InputError` if another process is at work in `out`, if it holds anything but an unfinished run of ours, or
    if it holds one and `resume` is off.
    """
    checkpoint, goes_on = out / _CHECKPOINT, unfinished(out)
    keep = refuse_foreign(out)
    created = not out.exists()
    try:
        with only_run(checkpoint, out):
            if goes_on and not resume:
                raise InputError(
                    f"the folder {out} holds an unfinished run; go on with --resume (resume=True), choose another "
                    "folder, or delete it."
                )
            with claim_output(out, keep=keep) as staging:
                yield RunFolder(staging, checkpoint)
            Checkpoint(checkpoint).remove()
    finally:
        if created:
            with contextlib.suppress(OSError):
                out.rmdir()


@contextlib.contextmanager
def only_run(folder: Path, out: Path) -> Iterator[None]:
    """Hold a folder, which is made if need be, for this process.

    The system lets go when a process dies, however it dies; an empty folder is taken away at the end.
    """
    lock = FileLock(folder / LOCK, timeout=_PATIENCE, fallback_to_soft=False)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout as error:
        raise InputError(
            f"another run is writing to {out}; wait until it has ended, or choose another folder."
        ) from error
    except OSError as error:
        raise InputError(
            f"The output folder {out} cannot be written ({error.strerror or error}); choose another with --out."
        ) from error
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            Path(lock.lock_file).unlink()  # while it is held; who opened it meanwhile sees that it is gone
        lock.release()
        with contextlib.suppress(OSError):
            folder.rmdir()
