"""Keypoints that count beside the pixels: in the search, in the refinement, and only where there are any."""

from functools import cache

import jax
import jax.numpy as jnp
import pytest
from perturbed import arm_away, perturbed, vertex_errors

from jaxmocap.capture import Detections
from jaxmocap.character import retract
from jaxmocap.energies import search_energy
from jaxmocap.observation import Frame
from jaxmocap.refinement import DetectionPlan, Refinement, RefinePlan
from jaxmocap.search import SearchPlan
from jaxmocap.track import FrameTracker, Tracker

ENERGY = search_energy(uncovered_scale=4.0, step=2, sampling="nearest", fail="ignore", outside="ignore")
SEARCH = SearchPlan(step=4, iterations=8, particles=48)


@pytest.fixture(scope="module")
def tracked(world, tmp_path_factory):
    """The result of frame 2, which is not selected, from a frame in which the left arm is lost; with detections in
    some frames, or with none."""
    folder = world.write_keypoints(tmp_path_factory.mktemp("detected"), range(3))

    @cache
    def run(*frames, search=SEARCH):
        detections = Detections.open(world.capture, folder, frames) if frames else None
        tracker = Tracker(ENERGY, search, refine=None, detections=DetectionPlan() if frames else None)
        worker = FrameTracker(world.observations(detections), tracker, jax.random.key(0))
        state = worker.first(world.shown(1), arm_away(world, 1)).state
        return worker.track(state, world.shown(2)).result

    return run


def arm_error(world, pose) -> float:
    arm = world.character.skeleton.group("l_arm")
    moved = retract(world.character.skeleton, world.pose(2), jnp.zeros(39).at[jnp.array(arm)].set(0.3))
    vertices = vertex_errors(world, 2, moved) > 1e-4
    return float(vertex_errors(world, 2, pose)[vertices].mean())


@pytest.mark.slow
def test_a_lost_arm_is_found_beside_detections(world, tracked):
    """17 cm off; as `normal` searches, at every second pixel, it ends at 2. At every fourth it ended at 8 to 12."""
    hybrid = tracked(2, search=Tracker.preset("normal").search)
    assert arm_error(world, hybrid.pose) < 0.03
    assert hybrid.energy["keypoints"] < 0.1
    assert tracked(0).energy["keypoints"] == 0


@pytest.mark.slow
def test_a_frame_without_detections_is_tracked_by_its_pixels_alone(tracked):
    photometric, elsewhere = tracked(), tracked(0)
    assert "keypoints" not in photometric.energy
    assert elsewhere.pose.angles.tobytes() == photometric.pose.angles.tobytes()
    assert elsewhere.pose.root.tobytes() == photometric.pose.root.tobytes()


def test_detections_are_rows_of_the_refinement(world, tmp_path):
    """Limbs 8 degrees off are farther than their contours look; with detections three rounds bring them home, while
    from 12 degrees rounding decides how far three rounds come."""
    folder = world.write_keypoints(tmp_path / "keypoints", (1,))
    observations = world.observations(Detections.open(world.capture, folder))
    start, shown, rectangle = perturbed(world, 1, 8.0, kind="limbs"), world.shown(1), world.rectangle(1)
    frame = Frame(shown, rectangle, observations.problem(shown, rectangle, start))
    errors = []
    for detections in (None, DetectionPlan(weight=25.0)):
        refinement = Refinement(observations, RefinePlan(rounds=3), detections=detections)
        pose, _ = refinement(frame, start, None)
        errors.append(vertex_errors(world, 1, pose).mean())
    assert errors[1] < 0.1 * errors[0]
