"""From arguments to an exit code."""

import errno
import sys
from collections.abc import Sequence

import tyro

from jaxmocap._results import InputError
from jaxmocap._runtime import configure

from ._annotate import annotate
from ._batch import batch
from ._bench import bench
from ._body import body
from ._calibrate import calibrate
from ._cameras import cameras
from ._check import check
from ._demo import demo
from ._detect import detect
from ._doctor import doctor
from ._evaluate import evaluate
from ._export import export
from ._fit_character import fit_character
from ._import_dataset import import_dataset
from ._output import show_help
from ._read_motion import read_motion
from ._refine_cameras import refine_cameras
from ._register import register
from ._report_page import report_page
from ._rig import rig
from ._run_videos import run_videos
from ._scan import scan
from ._segment import segment
from ._sync import sync
from ._track import track
from ._view import view

YOUR_INPUT, INTERRUPTED = 2, 130
"""Exit codes; a bug of ours passes through, so that Python prints its traceback and exits with 1."""

_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)
_PLACE = (errno.EACCES, errno.EPERM, errno.ENOTDIR, errno.EEXIST, errno.EISDIR, errno.ENAMETOOLONG)
"""What is wrong with the disk, and with a place on it: the user's to mend, and no error of ours."""

_GROUPS = {
    "All in one": {"run": run_videos, "demo": demo},
    "Prepare a capture": {
        "sync": sync,
        "detect": detect,
        "annotate": annotate,
        "calibrate": calibrate,
        "cameras": cameras,
        "segment": segment,
        "check": check,
        "import-dataset": import_dataset,
    },
    "Make an actor": {"scan": scan, "rig": rig, "body": body, "fit-character": fit_character},
    "Track": {"register": register, "track": track, "batch": batch, "refine-cameras": refine_cameras},
    "Look and take away": {
        "view": view,
        "report-page": report_page,
        "export": export,
        "read-motion": read_motion,
    },
    "Measure": {"evaluate": evaluate, "bench": bench, "doctor": doctor},
}
_COMMANDS = {name: command for commands in _GROUPS.values() for name, command in commands.items()}
_DESCRIPTION = (
    "Markerless motion capture of one person from two or three handheld videos.\n\n"
    "Exit codes: 0 done; 2 the input cannot be used, one sentence says why; 3 tracking finished, but not every frame "
    "is to be trusted; 1 an error of jaxmocap itself, please report the traceback."
)


def run(arguments: Sequence[str]) -> int:
    """Run one command and return its exit code, which each verb gives; usage errors exit with 2."""
    configure()
    if list(arguments) in (["-h"], ["--help"]):
        show_help(_GROUPS, _DESCRIPTION)
        return 0
    try:
        _once_each(arguments)
        return tyro.extras.subcommand_cli_from_dict(
            _COMMANDS,
            prog="jaxmocap",
            description=_DESCRIPTION,
            args=list(arguments),
            config=(tyro.conf.FlagCreatePairsOff,),
        )
    except InputError as error:
        print(f"jaxmocap: {error}", file=sys.stderr)
        return YOUR_INPUT
    except OSError as error:
        if error.errno not in _DISK and not (error.errno in _PLACE and error.filename):
            raise
        where = f" {error.filename}" if error.filename else ""
        advice = "make room, or choose another folder" if error.errno in _DISK else "choose another place"
        print(f"jaxmocap: a file{where} cannot be read or written ({error.strerror}); {advice}.", file=sys.stderr)
        return YOUR_INPUT
    except KeyboardInterrupt:
        goes_on = "; the same command goes on where it stopped" if list(arguments[:1]) == ["run"] else ""
        print(f"jaxmocap: interrupted; no result was written{goes_on}.", file=sys.stderr)
        return INTERRUPTED


def _once_each(arguments: Sequence[str]) -> None:
    """Refuse an option that is given twice, of which the parser would take the last and pass over the first."""
    options = [part.split("=")[0].replace("_", "-") for part in arguments if part.startswith("--") and part != "--"]
    twice = next((option for option in options if options.count(option) > 1), None)
    if twice is not None:
        raise InputError(f"{twice} is given more than once; give it once, with all that it takes: {twice} A B.")
