import pytest
from synthetic_world import World, shared_world


@pytest.fixture(scope="session")
def world(tmp_path_factory) -> World:
    return shared_world(tmp_path_factory)
