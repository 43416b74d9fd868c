"""The sampler is a slot of the tracker: whichever fills it, a frame is tracked."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from perturbed import vertex_errors

from jaxmocap import samplers
from jaxmocap.energies import Posture, SearchEnergy, search_energy
from jaxmocap.search import SearchPlan
from jaxmocap.track import FrameTracker, Tracker

TRACKER = Tracker(
    search_energy(uncovered_scale=4.0, step=2, sampling="nearest", fail="ignore", outside="ignore"),
    SearchPlan(step=4, iterations=6, faces=0.5, particles=48, spread=0.6),
    refine=None,
    flow_start=False,
)


def tracked(world, tracker):
    """Frame 2, from the truth of the frame before."""
    worker = FrameTracker(world.observations(), tracker, jax.random.key(0))
    state = worker.first(world.shown(1), world.pose(1)).state
    return worker.track(state, world.shown(2)).result.pose


@pytest.mark.slow
@pytest.mark.parametrize(
    "sampler", [samplers.InteractingSimulatedAnnealing, samplers.CrossEntropy, samplers.RandomSearch]
)
def test_a_frame_is_tracked_with_every_sampler(world, sampler):
    """At the resolution of `normal`; the frame before is off by 1.65 cm."""
    still = vertex_errors(world, 2, world.pose(1)).mean()
    tracker = replace(TRACKER, search=SearchPlan(step=2, iterations=16, faces=0.25), sampler=sampler())
    assert vertex_errors(world, 2, tracked(world, tracker)).mean() < 0.7 * still


@pytest.mark.slow
def test_a_frame_is_tracked_with_another_sampler_than_the_default(world):
    """To the likeliest posture, whatever the pictures show: that energy compiles in half the time."""
    energy = SearchEnergy((Posture(),))
    found = tracked(world, replace(TRACKER, search_energy=energy, sampler=samplers.CrossEntropy()))
    skeleton = world.character.skeleton
    before, after = (float(Posture().score_pose(skeleton, pose, None)) for pose in (world.pose(1), found))
    assert after < 0.7 * before


@pytest.mark.parametrize("sampler", [samplers.CrossEntropy(sigma_min=0.1), samplers.RandomSearch(shrink=0.5)])
def test_the_plan_sets_the_sizes_of_a_sampler_and_leaves_its_other_numbers(sampler):
    plan = SearchPlan(iterations=9, particles=50)
    sized = plan.sized(sampler, (0, 7), share=0.5)
    assert (sized.num_particles, sized.num_iterations) == (25, 9)
    if isinstance(sampler, samplers.CrossEntropy):
        np.testing.assert_allclose(sized.sigma_min, [0.002, 0.00436])
        assert float(sized.smoothing) == float(sampler.smoothing)
    else:
        assert float(sized.shrink) == 0.5
