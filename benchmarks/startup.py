"""Seconds from the command to the first tracked frame, with cold and with warm caches.

    python benchmarks/startup.py ../shared/data/plaza [--quality normal] [--out FIGURES.json] [--gate BASELINE.json]

Runs `jaxmocap track --frames 0:2` three times in processes of their own, in empty cache folders: cold; warm, where
compiled programs, registration and appearance are taken from the caches; and with `--no-cache`, where only compiled
programs are. Frame 0 is a selected one, so frame 1 is the first to be tracked. Its time runs from the command until the
result with it lies in its folder, which the command tells when it begins with the report page; the whole command's runs
on until that page is written and the process has ended.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from figures import Figure, add_options, finish, record


def seconds(capture: Path, out: Path, caches: Path, quality: str, *extra: str) -> tuple[float, float, float, float]:
    """Until the result, of the whole command, of its preparation, and of its first tracked frame."""
    words = [sys.executable, "-m", "jaxmocap", "track", str(capture), "--out", str(out), "--frames", "0:2"]
    environment = os.environ | {"XDG_CACHE_HOME": str(caches), "JAX_COMPILATION_CACHE_DIR": str(caches / "xla")}
    words += ["--no-overlays", "--quality", quality, *extra]
    begin, result, said = time.perf_counter(), None, []
    with subprocess.Popen(
        words, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, bufsize=1
    ) as process:
        for line in process.stdout or ():
            said.append(line)
            if line.startswith("report page") and result is None:
                result = time.perf_counter() - begin
    whole = time.perf_counter() - begin
    if process.returncode not in (0, 3) or result is None:
        raise SystemExit("".join(said))
    report = json.loads((out / "report.json").read_text())
    return result, whole, report["seconds"]["prepare"], sum(report["verdicts"][1]["seconds"].values())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", type=Path)
    parser.add_argument("--quality", default="normal")
    add_options(parser)
    options = parser.parse_args()
    figures: list[Figure] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for kind, extra in (("cold", ()), ("warm", ()), ("warm, stages made anew", ("--no-cache",))):
            found = seconds(options.capture, folder / kind, folder / "caches", options.quality, *extra)
            for what, value in zip(
                ("to the first tracked frame", "of the whole command", "of preparation", "of that frame"),
                found,
                strict=True,
            ):
                figures.append(record(f"seconds {what}, {kind}", value, "s", 1.0))
    return finish(figures, options, capture=options.capture.name, quality=options.quality)


if __name__ == "__main__":
    raise SystemExit(main())
