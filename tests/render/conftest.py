import jax
import numpy as np
import pytest

from jaxmocap.character import Pose, pelvis_position, skin
from jaxmocap.synthetic import dance, make_actor


@pytest.fixture(scope="session")
def actor():
    return make_actor()


@pytest.fixture(scope="session")
def dancers(actor):
    """Vertices of the synthetic actor in three poses, pelvis at the origin."""
    poses = dance(actor.skeleton, np.array([0.0, 0.4, 0.9]))
    found = []
    for index in range(3):
        pose = Pose(*jax.tree.map(lambda leaf, i=index: leaf[i], (poses.root, poses.angles)))
        found.append(np.asarray(skin(actor, pose) - pelvis_position(actor.skeleton, pose)))
    return found
