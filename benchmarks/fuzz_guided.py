"""Readers of files against damage that looks for new ways through the code.

    pip install atheris
    python benchmarks/fuzz_guided.py [--seconds 60] [--seed 0] [--only BVH ...] [--keep FOLDER]

As `benchmarks/fuzz.py`, but libFuzzer, by way of atheris, sees which branches of the package an input reaches and
damages those further that reach new ones. Every reader has a process of its own. The same counts, kept inputs and exit
code. Linux only.
"""

import argparse
import contextlib
import io
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import atheris

with contextlib.redirect_stderr(io.StringIO()), atheris.instrument_imports(include=["jaxmocap"]):
    import fuzz


def look_for_ways(name: str, seconds: float, seed: int, keep: Path, counts_file: Path) -> None:
    """Read damaged copies of one file for so long; atheris ends the process, so the counts go into a file."""
    fuzz.notice_hangs()
    folder = counts_file.with_suffix("")
    corpus = folder / "corpus"
    corpus.mkdir(parents=True)
    path, read = fuzz.sound_files(folder)[name]
    sound, counts, end = path.read_bytes(), Counter(), time.monotonic() + seconds
    (corpus / "sound").write_bytes(sound)

    def look(data: bytes) -> None:
        if time.monotonic() > end:
            counts_file.write_text(json.dumps(counts))
            os._exit(0)
        fuzz.attempt(path, read, data, keep, counts)

    # Hangs are noticed by our own alarm, which libFuzzer would take for its own time-out.
    flags = [f"-seed={seed + 1}", "-timeout=0", f"-max_len={2 * len(sound)}", "-rss_limit_mb=0", "-verbosity=0"]
    atheris.Setup([sys.argv[0], *flags, str(corpus)], look)
    atheris.Fuzz()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0, help="for each reader")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", help="names of readers, as in the table")
    parser.add_argument("--keep", type=Path, default=Path("fuzz_findings"), help="folder for inputs that crash or hang")
    parser.add_argument("--counts", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.counts is not None:
        look_for_ways(options.only[0], options.seconds, options.seed, options.keep, options.counts)
        return 1  # never reached
    total = Counter()
    with tempfile.TemporaryDirectory() as folder:
        names = options.only or list(fuzz.sound_files(Path(folder)))
        for number, name in enumerate(names):
            counts_file = Path(folder) / f"{number}.json"
            words = ["--only", name, "--counts", counts_file, "--keep", options.keep, "--seed", options.seed]
            words += ["--seconds", options.seconds]
            subprocess.run([sys.executable, __file__, *map(str, words)], check=False)
            if counts_file.is_file():
                counts = Counter(json.loads(counts_file.read_text()))
            else:
                counts = Counter(crashed=1)
                print(f"{name}: the process itself died.", file=sys.stderr)
            print(fuzz.row(name, counts), flush=True)
            total += counts
    print(fuzz.row("all", total))
    return int(total["crashed"] + total["hung"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
