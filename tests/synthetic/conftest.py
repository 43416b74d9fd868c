import pytest

from jaxmocap.synthetic import SyntheticCapture, make_capture


@pytest.fixture(scope="session")
def small_capture() -> SyntheticCapture:
    return make_capture(3, (192, 108), seed=1)
