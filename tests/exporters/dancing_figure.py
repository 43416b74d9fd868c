"""A dancing figure that came with a rig of its own, filmed by two moving cameras."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from humanoid_glb import MIXAMO, Humanoid, write_glb

from jaxmocap.camera import Cameras
from jaxmocap.character import Character
from jaxmocap.motion import Motion
from jaxmocap.synthetic import dance, filming_distance, handheld_paths

TIMES = np.array([0.0, 0.033, 0.067, 0.1, 0.15, 0.167])
"""Seconds, as uneven as a phone's."""


def cameras_over(times: np.ndarray) -> Cameras:
    """Two handheld cameras whose principal points are off the middle and whose pixels are not square."""
    poses = handheld_paths(times, np.zeros((len(times), 3)), filming_distance((640, 360)))
    intrinsics = jnp.array([[[700.0, 0, 330], [0, 690, 175]], [[500.0, 0, 320], [0, 500, 180]]])
    intrinsics = jnp.concatenate([intrinsics, jnp.broadcast_to(jnp.array([[[0.0, 0, 1]]]), (2, 1, 3))], axis=1)
    return Cameras(
        names=("left", "right"),
        sizes=((640, 360), (640, 360)),
        intrinsics=intrinsics,
        distortion=jnp.zeros((2, 5)).at[0, 0].set(0.1),
        cam_from_world=jnp.asarray(poses, jnp.float32),
    )


@pytest.fixture(scope="session")
def actor(tmp_path_factory) -> Path:
    """A figure in centimetres, lying along z, under an armature that puts it upright and into metres."""
    body = Humanoid()
    apart = body.vertices + 1e-4 * body.bone[:, None]  # so that corners of two boxes are not welded
    armature = np.array([[0.01, 0, 0, 0], [0, 0, 0.01, 0], [0, -0.01, 0, 0], [0, 0, 0, 1]])
    stand = lambda points: 100 * points @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # noqa: E731
    path = tmp_path_factory.mktemp("actor") / "dancer.glb"
    names, places, vertices = body.renamed(MIXAMO), stand(body.places), stand(apart)
    return write_glb(path, names, body.parents, places, vertices, body.faces, body.weights, armature)


@pytest.fixture(scope="session")
def character(actor) -> Character:
    return Character.load(actor)


@pytest.fixture(scope="session")
def motion(character, actor) -> Motion:
    """A dance at uneven times."""
    return danced(character, TIMES, actor)


@pytest.fixture(scope="session")
def even(character, actor) -> Motion:
    """A dance at 30 frames per second."""
    return danced(character, np.arange(12) / 30, actor)


def danced(character: Character, times: np.ndarray, actor: Path) -> Motion:
    rng = np.random.default_rng(0)
    return Motion.from_poses(
        character,
        dance(character.skeleton, times + 1.3),
        np.arange(len(times)) + 7,
        times + 0.5,
        cameras=cameras_over(times),
        confidence=rng.uniform(0.2, 1.0, (len(times), len(character.skeleton.landmark_names))),
        provenance={"actor": str(actor)},
    )
