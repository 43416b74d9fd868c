"""Optical flow along a clip whose poses are known up to noise: what it says of the way from frame to frame."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.character import Pose, retract
from jaxmocap.clip import flow_steps
from jaxmocap.clip._system import body_points, linearise
from jaxmocap.observation import Observations

FRAMES = range(3)
NOISE = 0.006
"""Metres and three times as many radians, standard deviation on every degree of freedom."""


def stacked(poses) -> Pose:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *poses)


def places_of(skeleton, poses: Pose) -> np.ndarray:
    return linearise(skeleton, body_points(skeleton), poses, np.zeros((len(poses.root), skeleton.num_dofs)))[0]


@pytest.fixture(scope="module")
def true(world) -> Pose:
    return stacked([world.pose(frame) for frame in FRAMES])


@pytest.fixture(scope="module")
def noisy(world, true) -> Pose:
    skeleton = world.character.skeleton
    noise = np.random.default_rng(0).normal(0, skeleton.per_dof(NOISE, 3 * NOISE), (len(FRAMES), skeleton.num_dofs))
    return jax.vmap(lambda pose, step: retract(skeleton, pose, step))(true, jnp.asarray(noise, jnp.float32))


@pytest.fixture(scope="module")
def steps(world, noisy):
    told = []
    found = flow_steps(world.observations(), FRAMES, noisy, lambda done, total: told.append((done, total)))
    assert told == [(done, len(FRAMES)) for done in range(1, len(FRAMES) + 1)]
    return found


def test_flow_tells_ways_better_than_the_poses_it_begins_with(world, true, noisy, steps):
    skeleton = world.character.skeleton
    right, begun = (np.diff(places_of(skeleton, poses), axis=0) for poses in (true, noisy))
    errors = [np.linalg.norm(ways - right, axis=-1).mean() for ways in (begun, steps.ways)]
    assert errors[1] < 0.5 * errors[0], errors


def test_its_errors_are_those_it_says(world, true, steps):
    right = np.diff(places_of(world.character.skeleton, true), axis=0)
    errors = (steps.ways - right)[..., None]
    squares = (errors * np.linalg.solve(steps.covariance, errors)).sum((2, 3)) / 3
    assert 0.05 < np.median(squares) < 2.0
    assert np.percentile(squares, 90) < 9.0


def test_where_nothing_is_seen_it_says_nothing(world, noisy, monkeypatch):
    frames = Observations.frames

    def dark(self, numbers):
        return (
            shown._replace(images=[np.zeros_like(image) for image in shown.images]) for shown in frames(self, numbers)
        )

    monkeypatch.setattr(Observations, "frames", dark)
    found = flow_steps(world.observations(), FRAMES[:2], jax.tree.map(lambda leaf: leaf[:2], noisy))
    assert np.sqrt(np.linalg.eigvalsh(found.covariance)[..., -1].min()) > 0.1  # metres, twenty times what a pose is off
