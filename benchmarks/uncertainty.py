"""How often the regions of a result's uncertainty hold the true joints, and what scale would make them right.

    python benchmarks/uncertainty.py RESULT [RESULT ...] [--out FIGURES.json] [--gate BASELINE.json]

Every result must be of a capture with true joints. Besides the coverage of the 50, 90 and 99 % regions it prints the
median and the 95th percentile of the errors in standard deviations (1.80 and 6.56 if the covariance is right), and the
factor on all deviations at which the 90 % region would hold 90 %.
"""

import argparse
from pathlib import Path

import numpy as np
from figures import Figure, add_options, finish, record
from scipy.stats import f

from jaxmocap.metrics import Truth, joint_errors
from jaxmocap.motion import TAILS, Motion

SHARES = (0.5, 0.9, 0.99)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", type=Path, nargs="+")
    add_options(parser)
    options = parser.parse_args()
    figures: list[Figure] = []
    for folder in options.results:
        motion = Motion.load(folder)
        truth, evaluated = Truth.read(motion.provenance["truth"]).at(motion)
        spread = evaluated.joint_deviations
        if truth.joints is None or spread is None:
            raise SystemExit(f"{folder} has no uncertainty, or its truth no joints.")
        errors = joint_errors(evaluated, truth.joints, truth.joint_names)
        deviations = np.asarray(errors.deviations)[np.isfinite(errors.raw)]
        name = "/".join(folder.resolve().parts[-2:])  # two seeds of one capture have figures of their own
        for share in SHARES:
            figures.append(
                record(f"{name}: coverage of the {share:.0%} region", errors.coverage(share), "", 0.1, "higher")
            )
        figures.append(record(f"{name}: median error", float(np.median(deviations)), "deviations", 0.2))
        figures.append(record(f"{name}: 95th percentile", float(np.percentile(deviations, 95)), "deviations", 0.2))
        factor = float(np.percentile(deviations, 90) / np.sqrt(3 * f.ppf(0.9, 3, TAILS)))
        figures.append(record(f"{name}: factor that makes the 90% region right", factor, "", 0.2))
        figures.append(record(f"{name}: median deviation along one axis", float(100 * np.median(spread)), "cm", 0.2))
    return finish(figures, options)


if __name__ == "__main__":
    raise SystemExit(main())
