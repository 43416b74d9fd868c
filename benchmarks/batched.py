"""Searches of an arm with every lambda and every seed, in one compiled call, against a loop in Python over the same.

    python benchmarks/batched.py --out batched.json

One core, 64 particles, 10 iterations, every fourth pixel of a frame of the built-in capture. Both sides are compiled
before they are timed, and take turns; `--driver scatter` maps with `jax.vmap`, as on an accelerator.
"""

import argparse
import os
import sys

os.environ["JAX_NUM_CPU_DEVICES"] = "1"

import jax
import jax.numpy as jnp
import numpy as np
from figures import Figure, add_options, finish, record
from rasterisers import median_ms
from scene import scene

from jaxmocap.energies import search_energy
from jaxmocap.experiments import SearchBatch
from jaxmocap.samplers import InteractingSimulatedAnnealing

LAMBDAS = (0.0, 0.1, 0.3, 1.0)


def measured(seeds: int, repeats: int, driver: str | None) -> list[Figure]:
    """Times of both sides, their ratio, and the largest difference of the increments found."""
    character, pose, problem = scene()
    sampler = InteractingSimulatedAnnealing(num_particles=64, num_iterations=10)
    batch = SearchBatch.make(search_energy(), sampler, character, pose, problem, "l_arm", driver=driver)
    lambdas = jnp.array(LAMBDAS)

    def together() -> np.ndarray:
        return np.asarray(batch({"terms.view_view.weight": lambdas}, jnp.arange(seeds)).increments)

    def looped() -> np.ndarray:
        energies = [batch.energy.reweight(view_view=value) for value in lambdas]
        found = [[batch.one(energy, jax.random.key(seed))[0] for seed in range(seeds)] for energy in energies]
        return np.stack([np.stack(row) for row in found])

    taken = median_ms({"one call": together, "loop": looped}, repeats)
    searches = len(LAMBDAS) * seeds
    return [
        record("one call", taken["one call"] / searches, "ms per search", 0.5),
        record("Python loop", taken["loop"] / searches, "ms per search", 0.5),
        record("Python loop / one call", taken["loop"] / taken["one call"], "", 0.2, "higher"),
        record("largest difference of the increments", float(np.abs(together() - looped()).max()), "radians", 1.0),
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--driver", choices=("loop", "scatter"))
    add_options(parser)
    options = parser.parse_args()
    return finish(measured(options.seeds, options.repeats, options.driver), options)


if __name__ == "__main__":
    sys.exit(main())
