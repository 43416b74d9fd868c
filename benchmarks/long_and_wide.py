"""Whether memory stays flat and time linear in long clips, and what more cameras, pixels and frames per second cost.

    python benchmarks/long_and_wide.py ../shared/data/plaza [--only "300 frames" ...] [--out FIGURES.json]

Long: the first 30 frames of the capture, half as large, forwards and backwards until there are 30, 100 and 300. Wide:
synthetic captures of 1 to 4 cameras, of 480p to 4K (made smaller, as everywhere), and of 60 to 240 frames per second.
Every one is tracked in a process of its own, without stages from earlier runs. Seconds per frame are medians; the peak
of the memory is the process's, and so holds the compiler's too.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from broken_captures import looped
from figures import Figure, add_options, finish, record

from jaxmocap.metrics import evaluate
from jaxmocap.synthetic import make_capture, write_capture

Make = Callable[[Path, Path], Path]
"""(the capture, a new folder) -> a capture."""


def _filmed(frames: int, size: tuple[int, int], cameras: int = 2, fps: float = 30.0) -> Make:
    def make(_: Path, folder: Path) -> Path:
        return write_capture(make_capture(frames, size, cameras, fps=fps, supersampling=1), folder)

    return make


def _looped(count: int) -> Make:
    return lambda capture, folder: looped(capture, folder, count)


SMALL = (640, 360)
SIZES = {"480p": (854, 480), "1080p": (1920, 1080), "4K": (3840, 2160)}
CASES: dict[str, Make] = {
    **{f"{count} frames": _looped(count) for count in (30, 100, 300)},
    **{f"{count} cameras": _filmed(8, SMALL, count) for count in (1, 2, 3, 4)},
    **{name: _filmed(8, size) for name, size in SIZES.items()},
    **{f"{fps} fps": _filmed(16, SMALL, fps=fps) for fps in (60, 120, 240)},
}


def measure(name: str, capture: Path, quality: str) -> list[Figure]:
    """Make one of the captures, track it and read its figures."""
    with tempfile.TemporaryDirectory() as scratch:
        made, out = CASES[name](capture, Path(scratch) / "capture"), Path(scratch) / "result"
        words = [sys.executable, "-m", "jaxmocap", "track", str(made), "--out", str(out), "--quality", quality]
        process = subprocess.Popen([*words, "--no-overlays", "--no-cache"], stdout=subprocess.DEVNULL)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode not in (0, 3):  # lost frames are a result too
            raise SystemExit(f"{' '.join(words)} failed.")
        report = json.loads((out / "report.json").read_text())
        scores = evaluate(out, made / "truth.npz")
    seconds = [sum(verdict["seconds"].values()) for verdict in report["verdicts"]][2:]
    return [
        record(f"{name}: seconds per frame", float(np.median(seconds)), "s", 0.5),
        record(f"{name}: peak memory", usage.ru_maxrss / 2**20, "GiB", 0.2),
        record(f"{name}: marker error, mean", scores["marker_error_cm"]["mean"], "cm", 0.3),
        record(f"{name}: lost frames", report["lost_frames"], "", 0.0),
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", type=Path)
    parser.add_argument("--only", nargs="+", choices=list(CASES), help="some of the cases")
    parser.add_argument("--quality", default="draft")
    add_options(parser)
    options = parser.parse_args()
    figures: list[Figure] = []
    for name in options.only or CASES:
        figures += measure(name, options.capture, options.quality)
        print(name, *(f"{float(str(figure['value'])):.4g} {figure['unit']}" for figure in figures[-4:]), flush=True)
    values = {figure["metric"]: float(str(figure["value"])) for figure in figures}
    for what, key in (("peak memory", "growth of the peak"), ("seconds per frame", "growth of the time per frame")):
        first, last = (values.get(f"{count} frames: {what}") for count in (30, 300))
        if first is not None and last is not None:
            figures.append(record(f"{key} from 30 to 300 frames", 100 * (last / first - 1), "%", 0.5))
    return finish(figures, options, quality=options.quality, capture=options.capture.name)


if __name__ == "__main__":
    raise SystemExit(main())
