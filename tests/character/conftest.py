"""Characters the tests share: a box figure always, the shipped actors where the captures are present."""

import os
from pathlib import Path

import humanoid_glb
import numpy as np
import pytest

from jaxmocap.character import Character

DATA = Path(os.environ.get("JAXMOCAP_DATA", Path(__file__).parents[3] / "shared" / "data"))


@pytest.fixture(scope="session")
def humanoid() -> humanoid_glb.Humanoid:
    return humanoid_glb.Humanoid()


@pytest.fixture(scope="session")
def box_figure(humanoid, tmp_path_factory) -> Character:
    """The box figure, symmetric and in T-pose."""
    path = tmp_path_factory.mktemp("figure") / "figure.glb"
    mesh = (humanoid.places, humanoid.vertices, humanoid.faces, humanoid.weights)
    return Character.load(humanoid_glb.write_glb(path, humanoid.renamed(humanoid_glb.MIXAMO), humanoid.parents, *mesh))


@pytest.fixture(scope="session")
def actor_path() -> Path:
    path = DATA / "plaza" / "actor.glb"
    if not path.is_file():
        pytest.skip(f"{path} is absent; set JAXMOCAP_DATA to the captures")
    return path


@pytest.fixture(scope="session")
def actor(actor_path) -> Character:
    """The actor of the capture `plaza`: A-pose with bent elbows."""
    return Character.load(actor_path)


@pytest.fixture(scope="session")
def rng() -> np.random.Generator:
    return np.random.default_rng(0)
