import sys
from pathlib import Path

import pytest
from synthetic_world import World, shared_world

sys.path.insert(0, str(Path(__file__).parents[1] / "render"))


@pytest.fixture(scope="session")
def world(tmp_path_factory) -> World:
    return shared_world(tmp_path_factory)
