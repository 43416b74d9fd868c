"""What is compiled for captures that are tracked one after the other, each with the caches of those before it.

    python benchmarks/compiling.py demo ../shared/data/plaza:0:12 ../shared/data/street:0:4 [--quality normal]
        [--out FIGURES.json] [--gate BASELINE.json]

Every capture is tracked in a process of its own; `demo` is the demo's, and `:A:B` the frames. The first one finds
empty caches and shows what a fresh installation compiles, the others what a new capture does where another one has
been tracked. Programs that take longer than half a second, and the seconds of all, count; one that is read from the
caches takes milliseconds. Seconds are of the wall: nothing else may run. Where a capture has its truth the error stands
beside.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from figures import Figure, add_options, finish, record

BIG = 0.5
"""Seconds from which on a program counts as big."""


def track(wanted: str, quality: str, work: Path) -> None:
    """Track one capture in this process; print the programs as [name, seconds] and the error."""
    import jaxmocap as jm

    jm.configure()
    import jax

    from jaxmocap.metrics import evaluate
    from jaxmocap.pipeline import track_capture
    from jaxmocap.synthetic import make_capture, write_capture

    path, *span = wanted.split(":")
    folder = write_capture(make_capture(10, (480, 270)), work / "film") if path == "demo" else Path(path)
    programs: list[tuple[str, float]] = []

    def listen(event: str, seconds: float, **about: str) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            programs.append((about["fun_name"].removeprefix("jit(").removesuffix(")"), seconds))

    jax.monitoring.register_event_duration_secs_listener(listen)
    frames = (int(span[0]), int(span[1])) if span else None
    track_capture(folder, work / "result", frames=frames, quality=quality, overlays=False)
    error = None
    if (folder / "truth.npz").exists():
        error = evaluate(work / "result", folder / "truth.npz").get("marker_error_cm", {}).get("mean")
    print(json.dumps({"programs": programs, "error": error}))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("captures", nargs="+", help="demo, or FOLDER[:START:STOP]")
    parser.add_argument("--quality", default="normal")
    parser.add_argument("--here", type=Path, help=argparse.SUPPRESS)
    add_options(parser)
    options = parser.parse_args()
    if options.here is not None:
        track(options.captures[0], options.quality, options.here)
        return 0
    figures: list[Figure] = []
    with tempfile.TemporaryDirectory() as name:
        caches = os.environ | {"XDG_CACHE_HOME": str(Path(name) / "caches")}
        for number, wanted in enumerate(options.captures):
            words = [sys.executable, __file__, wanted, "--quality", options.quality, "--here", f"{name}/{number}"]
            (Path(name) / str(number)).mkdir()
            done = subprocess.run(words, env=caches, check=True, stdout=subprocess.PIPE, text=True)
            found = json.loads(done.stdout.splitlines()[-1])
            big = Counter(name for name, seconds in found["programs"] if seconds > BIG)
            what = f"{Path(wanted.split(':')[0]).name}, after {number} other{'s' * (number != 1)}"
            figures.append(record(f"programs above {BIG} s, {what}", big.total(), "programs", 1.0))
            figures.append(record(f"seconds of compiling, {what}", sum(s for _, s in found["programs"]), "s", 1.0))
            if found["error"] is not None:
                figures.append(record(f"marker error, {what}", found["error"], "cm", 1.0))
            print("   ", ", ".join(f"{name} {count}" for name, count in big.most_common()), flush=True)
    return finish(figures, options, captures=options.captures, quality=options.quality)


if __name__ == "__main__":
    raise SystemExit(main())
