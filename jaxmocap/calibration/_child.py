"""Running the worker, so that a crash of native code ends a child process and not the program."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from jaxmocap._results import InputError

Report = Callable[[str, int, int], None]


def run_worker(task: str, folder: Path, report: Report) -> None:
    """Run `_worker` on a task and pass its progress on. Raises `InputError` with its sentence for unusable footage and
    for a crash of the native code, `RuntimeError` with its traceback for a bug.

    A fresh interpreter and no fork or `multiprocessing`: the caller's script need not guard its main part.
    """
    package = str(Path(__file__).parents[2])
    path = os.pathsep.join([package, *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = os.environ | {"PYTHONPATH": path, "JAX_PLATFORMS": "cpu"}
    arguments = [sys.executable, "-m", "jaxmocap.calibration._worker", task, str(folder)]
    errors = folder / f"{task}.log"
    sentence = None
    with errors.open("wb") as log:
        child = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=log, env=environment, text=True)
        try:
            assert child.stdout is not None
            for line in child.stdout:
                message = _message(line)
                if "progress" in message:
                    report(*message["progress"])
                sentence = message.get("error", sentence)
            code = child.wait()
        finally:
            if child.poll() is None:
                child.kill()
                child.wait()
    if code == 0:
        return
    if sentence is not None:
        raise InputError(sentence)
    tail = "\n".join(errors.read_text(encoding="utf-8", errors="replace").splitlines()[-30:])
    if code == 1:
        raise RuntimeError(f"the calibration failed:\n{tail}")
    raise InputError(
        f"structure from motion ended by {_ending(code)} and left no cameras; nothing was changed. Try again with "
        "another --seed or --key-step, or with more memory free."
    )


def _message(line: str) -> dict:
    """A line of the worker as JSON; other output is ignored."""
    try:
        message = json.loads(line)
    except ValueError:
        return {}
    return message if isinstance(message, dict) else {}


def _ending(code: int) -> str:
    """How a process ended, in words."""
    if code < 0:
        name = signal.Signals(-code).name if -code in {s.value for s in signal.Signals} else f"signal {-code}"
        return f"a crash ({name})"
    return f"exit code {code}"
