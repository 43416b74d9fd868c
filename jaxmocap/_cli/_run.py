"""From arguments to an exit code."""

import errno
import sys
from collections.abc import Sequence

import tyro

from jaxmocap._results import InputError
from jaxmocap._runtime import configure

from ._annotate import annotate
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
from ._read_motion import read_motion
from ._refine_cameras import refine_cameras
from ._register import register
from ._report_page import report_page
from ._rig import rig
from ._run_videos import run_videos
from ._segment import segment
from ._sync import sync
from ._track import track
from ._view import view

YOUR_INPUT, INTERRUPTED = 2, 130
"""Exit codes; a bug of ours passes through, so that Python prints its traceback and exits with 1."""

_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)

_COMMANDS = {
    "run": run_videos,
    "demo": demo,
    "check": check,
    "sync": sync,
    "detect": detect,
    "calibrate": calibrate,
    "cameras": cameras,
    "annotate": annotate,
    "segment": segment,
    "rig": rig,
    "body": body,
    "fit-character": fit_character,
    "register": register,
    "track": track,
    "refine-cameras": refine_cameras,
    "report-page": report_page,
    "evaluate": evaluate,
    "export": export,
    "view": view,
    "read-motion": read_motion,
    "doctor": doctor,
    "import-dataset": import_dataset,
    "bench": bench,
}
_DESCRIPTION = """Markerless motion capture of one person from two or three handheld videos.

Exit codes: 0 done; 2 the input cannot be used, one sentence says why; 3 tracking finished, but not every
frame is to be trusted; 1 an error of jaxmocap itself, please report the traceback."""


def run(arguments: Sequence[str]) -> int:
    """Run one command and return its exit code, which each verb gives; usage errors exit with 2."""
    configure()
    try:
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
        if error.errno not in _DISK:
            raise
        where = f" {error.filename}" if error.filename else ""
        print(
            f"jaxmocap: a file{where} cannot be written ({error.strerror}); make room, or choose another folder.",
            file=sys.stderr,
        )
        return YOUR_INPUT
    except KeyboardInterrupt:
        print("jaxmocap: interrupted; no result was written.", file=sys.stderr)
        return INTERRUPTED
