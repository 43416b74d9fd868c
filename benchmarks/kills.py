"""Kill a tracking run at random moments, resume it, and compare the results byte for byte.

python benchmarks/kills.py [--moments 20] [--seed 0] [--frames 6] [--capture FOLDER] [--quality draft]

Every trial starts `jaxmocap track`, sends SIGKILL at a moment drawn evenly from the time that an uninterrupted run
takes, and lets `--resume` finish. `motion.npz` must be the same bytes. Exits with 1 when one is not. Without --capture
a synthetic one is filmed. Registration and appearance are not taken from earlier runs.
"""

import argparse
import hashlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def command(arguments: argparse.Namespace, capture: Path, out: Path, *extra: str) -> list[str]:
    """The run, without pictures of it."""
    words = [sys.executable, "-m", "jaxmocap", "track", str(capture), "--out", str(out), "--quality", arguments.quality]
    return [*words, "--frames", f"0:{arguments.frames}", "--no-overlays", "--no-cache", *extra]


def finish(words: list[str]) -> None:
    """Run to the end; lost frames (3) are a result too."""
    done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode not in (0, 3):
        raise SystemExit(f"{' '.join(words)} failed:\n{done.stderr}")


def content(out: Path) -> str:
    return hashlib.sha256((out / "motion.npz").read_bytes()).hexdigest()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--moments", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--capture", type=Path)
    parser.add_argument("--quality", default="draft")
    arguments = parser.parse_args()
    draw, same = random.Random(arguments.seed), 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        capture = arguments.capture
        if capture is None:
            from jaxmocap.synthetic import make_capture, write_capture

            capture = write_capture(make_capture(arguments.frames, (320, 180)), folder / "capture")
        finish(command(arguments, capture, folder / "warm"))  # compiles
        begin = time.perf_counter()
        finish(command(arguments, capture, folder / "whole"))
        length, whole = time.perf_counter() - begin, content(folder / "whole")
        for trial in range(arguments.moments):
            out, moment = folder / f"killed_{trial}", draw.uniform(0, length)
            run = subprocess.Popen(
                command(arguments, capture, out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
            try:
                run.wait(moment)
            except subprocess.TimeoutExpired:
                os.kill(run.pid, signal.SIGKILL)
                run.wait()
            left = sorted(path.name for path in (out / "checkpoint").glob("*.npz")) if out.exists() else []
            finish(command(arguments, capture, out, "--resume"))
            same += content(out) == whole
            verdict = "same bytes" if content(out) == whole else "OTHER BYTES"
            print(f"killed after {moment:6.1f} of {length:.1f} s, {len(left)} files kept: {verdict}", flush=True)
    print(f"{same} of {arguments.moments} the same")
    return 0 if same == arguments.moments else 1


if __name__ == "__main__":
    raise SystemExit(main())
