"""Seconds per frame by stage, start-up apart, with the accuracy beside them and the peak memory.

    python benchmarks/stages.py ../shared/data/plaza [--out FIGURES.json] [--gate BASELINE.json]

Every figure is a small record: metric, value, unit, direction ("lower" is better), tolerance (relative, for `--gate`).
`--gate BASELINE.json` exits with 1 when a figure is worse than the baseline by more than its tolerance. Times are means
over the frames that do not compile: not the first two, nor any that takes more than three times the median. Ratios hold
within one run only: machines differ, and are noisy. The same command runs on a GPU where JAX has one; the file names
the device.
"""

import argparse
import json
import resource
import sys
import tempfile
import time
from pathlib import Path

import jaxmocap

jaxmocap.configure()

import jax  # noqa: E402
import numpy as np  # noqa: E402
from figures import Figure, add_options, finish, record  # noqa: E402

from jaxmocap.metrics import evaluate  # noqa: E402
from jaxmocap.pipeline import track_capture  # noqa: E402

TIME_TOLERANCE = 0.5
ERROR_TOLERANCE = 0.1
MEMORY_TOLERANCE = 0.2


def peak_memory() -> float:
    """GiB so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def measure(capture: Path, frames: tuple[int, int] | None, quality: str, seed: int) -> list[Figure]:
    """Track and read the figures off the report."""
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "result"
        peaks: dict[int, float] = {}

        def note(stage: str, done: int, _: int) -> None:
            if stage == "track":
                peaks[done] = peak_memory()

        motion = track_capture(
            capture, out, quality=quality, seed=seed, frames=frames, overlays=False, progress=note, cache=False
        )
        wall = time.perf_counter() - begin
        report = json.loads((out / "report.json").read_text())
        truth = motion.provenance.get("truth")
        scores = evaluate(out, truth) if truth else {}
    per_frame = [verdict["seconds"] for verdict in report["verdicts"]]
    settled = per_frame[2:] or per_frame
    usual = 3 * np.median([sum(seconds.values()) for seconds in settled])
    settled = [seconds for seconds in settled if sum(seconds.values()) <= usual]
    stages = sorted({name for seconds in settled for name in seconds})
    total = float(np.mean([sum(seconds.values()) for seconds in settled]))
    figures = [
        record(f"seconds per frame, {n}", float(np.mean([s.get(n, 0) for s in settled])), "s", TIME_TOLERANCE)
        for n in stages
    ]
    figures.append(record("seconds per frame, all stages", total, "s", TIME_TOLERANCE))
    figures.append(record("frames per second", 1 / total, "1/s", TIME_TOLERANCE, "higher"))
    figures.append(
        record(
            "seconds of the first tracked frame, compiling",
            sum(per_frame[min(1, len(per_frame) - 1)].values()),
            "s",
            1.0,
        )
    )
    figures.append(record("seconds of registration and appearance, compiling", report["seconds"]["prepare"], "s", 1.0))
    figures.append(record("seconds in all", wall, "s", 1.0))
    figures.append(record("peak memory", peak_memory(), "GiB", MEMORY_TOLERANCE))
    if {30, 90} <= set(peaks):
        figures.append(record("peak at frame 90 / at frame 30", peaks[90] / peaks[30], "", 0.05))
    errors = {"marker_error_cm": "marker error, mean", "joint_error_cm": "error of the comparable joints, mean"}
    for name, metric in errors.items():
        if name in scores:
            figures.append(record(metric, scores[name]["mean"], "cm", ERROR_TOLERANCE))
    return figures


def device() -> str:
    """The machine JAX computes on."""
    return f"{len(jax.local_devices())} x {jax.devices()[0].device_kind}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--frames", help="A:B")
    parser.add_argument("--quality", default="normal", choices=("draft", "normal", "paper"))
    parser.add_argument("--seed", type=int, default=0)
    add_options(parser)
    options = parser.parse_args()
    frames = tuple(int(part) for part in options.frames.split(":")) if options.frames else None
    figures = measure(options.capture, frames, options.quality, options.seed)
    return finish(figures, options, quality=options.quality, capture=options.capture.name, device=device())


if __name__ == "__main__":
    sys.exit(main())
