"""Particles shared out among the devices of a CPU, of which a process has as many as it was started with."""

import os
import subprocess
import sys

import pytest

CODE = """
import importlib, jax, jax.numpy as jnp, numpy as np
share_out = importlib.import_module("jaxmocap.energies._search_energy")._share_out
rows = jax.random.normal(jax.random.key(0), (7, 39))

def score(scale, rows):
    return jax.lax.map(lambda row: (jnp.stack([jnp.sin(scale * row).sum(), row[0]]), row[1] > 0), rows)

@jax.jit
def search(rows):
    def step(rows, _):
        terms, needed = share_out(score, jnp.float32(2), rows)
        return rows - 0.1 * terms.mean(0)[0], (terms, needed.any())  # a sampler, too, sums over particles
    return jax.lax.scan(step, rows, None, length=4)

text = search.lower(rows).compile().as_text()
print(jax.device_count(), text.count("all-gather("), text.count("all-reduce("))
print([np.asarray(value).tobytes().hex() for value in jax.tree.leaves(search(rows))])
"""


def on_devices(count: int) -> list[str]:
    environment = os.environ | {"JAX_NUM_CPU_DEVICES": str(count), "JAX_PLATFORMS": "cpu"}
    done = subprocess.run([sys.executable, "-c", CODE], env=environment, capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


@pytest.mark.slow
def test_devices_share_the_particles_and_wait_for_each_other_once_a_generation():
    (alone, bits), (shared, same) = on_devices(1), on_devices(3)
    assert alone == "1 0 0"
    count, gathered, summed = map(int, shared.split())
    assert count == 3
    assert 1 <= gathered <= 2  # the terms and the windows needed
    assert summed == 0
    assert bits == same
