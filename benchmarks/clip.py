"""What solving a clip as a whole brings where no picture is looked at again: smooth motion alone, and with feet that
stand, beside the frames as tracked. What the pictures add is a row of `ablation.py`.

    jaxmocap track ../shared/data/plaza --out plaza-0 --set clip=off
    python benchmarks/clip.py plaza-0 plaza-1 plaza-2

Results are those of captures with truth, tracked with `--set clip=off`; several are seeds or captures. Every figure is
a small record as in `stages.py`, mean and worst over the results; `--gate` compares with a committed file.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import jaxmocap

jaxmocap.configure()

import numpy as np  # noqa: E402
from figures import Figure, add_options, finish, record  # noqa: E402

from jaxmocap.clip import ClipPlan, solve_clip  # noqa: E402
from jaxmocap.metrics import evaluate  # noqa: E402
from jaxmocap.motion import Motion  # noqa: E402

PLANS = {"as tracked": None, "smooth": ClipPlan(contacts=False), "smooth, feet that stand": ClipPlan()}
SCORES = (
    ("marker error, mean", "marker_error_cm", "mean", "cm"),
    ("marker error, worst frame", "marker_error_cm", "max", "cm"),
    ("joint error, mean", "joint_error_cm", "mean", "cm"),
    ("joint error, 95th percentile", "joint_error_cm", "p95", "cm"),
    ("joint error without offsets, mean", "joint_error_offset_corrected_cm", "mean", "cm"),
    ("acceleration error, mean", "acceleration_error_m_per_s2", None, "m/s^2"),
    ("foot skate, mean", "foot_skate_m_per_s", "mean", "m/s"),
)


def solved(motion: Motion, plan: ClipPlan | None) -> tuple[Motion, float]:
    """Solve a motion by the plan; return it with the seconds that a frame took, compiling apart."""
    if plan is None:
        return motion, 0.0
    skeleton, clip = motion.character.skeleton, (motion.timestamps, motion.confidence, motion.up, plan)
    poses, _ = solve_clip(skeleton, motion.poses, *clip)
    begin = time.perf_counter()
    poses, _ = solve_clip(skeleton, motion.poses, *clip)
    seconds = (time.perf_counter() - begin) / len(motion)
    moved = Motion.from_poses(motion.character, poses, motion.frames, motion.timestamps)
    return replace(motion, root=moved.root, angles=moved.angles, joints=moved.joints), seconds


def measure(folders: list[Path]) -> list[Figure]:
    """Score every result under every plan."""
    figures, motions = [], {folder: Motion.load(folder) for folder in folders}
    for folder, motion in motions.items():
        if "contacts" in motion.provenance:
            sys.exit(f"{folder} was solved as a clip already; track it with --set clip=off.")
        if not motion.provenance.get("truth"):
            sys.exit(f"the capture of {folder} has no truth; choose one that has.")
    for name, plan in PLANS.items():
        results = [solved(motion, plan) for motion in motions.values()]
        scores = [evaluate(motion, motion.provenance["truth"]) for motion, _ in results]
        for label, key, part, unit in SCORES:
            values = [found[key] if part is None else found[key][part] for found in scores if key in found]
            if values:
                figures.append(record(f"{name}: {label}", float(np.mean(values)), unit, 0.1))
                figures.append(record(f"{name}: {label}, worst result", float(np.max(values)), unit, 0.2))
        if plan is not None:
            figures.append(record(f"{name}: seconds per frame", float(np.mean([s for _, s in results])), "s", 0.5))
    return figures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path, nargs="+")
    add_options(parser)
    options = parser.parse_args()
    return finish(measure(options.results), options, results=[folder.name for folder in options.results])


if __name__ == "__main__":
    sys.exit(main())
