"""What a run has done, kept in its folder: per stage, of what it was made, and what it wrote into `capture.toml`."""

import json
from pathlib import Path
from typing import Any

from jaxmocap._cache import digest
from jaxmocap._files import is_clutter, plain, write_json
from jaxmocap._results import InputError

from ._run_folder import LOCK

RECORD = "run.json"
_VERSION = 1


class RunRecord:
    """`run.json` of a run's folder: read once, written anew after every change."""

    def __init__(self, out: Path):
        """Open the record of a run in `out`, which may be new.

        Raises `InputError` where `out` is a file, or a folder that no run made.
        """
        self.out, self._file = out, out / RECORD
        self._stages: dict[str, dict[str, Any]] = {}
        if not out.exists():
            return
        if not out.is_dir():
            raise InputError(f"{out} is a file; a folder for the run was expected, choose another with --out")
        if not self._file.is_file():
            if not all(is_clutter(entry.name) or entry.name == LOCK for entry in out.iterdir()):  # of a first stage
                raise InputError(f"{out} holds files that no run wrote; choose a new or an empty folder with --out")
            return
        try:
            content = json.loads(self._file.read_text(encoding="utf-8"))
            self._stages = dict(content["stages"]) if content["version"] == _VERSION else {}
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(
                f"{self._file} cannot be read ({error}); choose another folder with --out, or delete {out} and every "
                "stage is done again"
            ) from error

    def done(self, stage: str, inputs: Any) -> bool:
        """Tell whether a stage was done of these inputs."""
        return stage in self._stages and self._stages[stage]["inputs"] == digest(plain(inputs))

    def begun(self, stage: str) -> bool:
        """Tell whether a stage was ever done."""
        return stage in self._stages

    def made(self, stage: str) -> Any:
        """Return what a stage wrote; None where it was not done."""
        return self._stages.get(stage, {}).get("made")

    def seconds(self, stage: str) -> float | None:
        """Say how long a stage took when it was last done."""
        return self._stages.get(stage, {}).get("seconds")

    def set(self, stage: str, inputs: Any, made: Any, seconds: float | None = None) -> None:
        """Note that a stage was done of `inputs`, and what it wrote."""
        before = self.seconds(stage)
        self._stages[stage] = {
            "inputs": digest(plain(inputs)),
            "made": plain(made),
            "seconds": before if seconds is None else round(seconds, 1),
        }
        write_json(self._file, {"version": _VERSION, "stages": self._stages})
