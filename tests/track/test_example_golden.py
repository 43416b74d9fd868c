"""The first frames of an example capture are tracked as well as when somebody last looked at them."""

import pytest
from golden import hold_against_golden

from jaxmocap.pipeline import track_capture

pytestmark = pytest.mark.slow

FRAMES = (0, 10)


@pytest.mark.parametrize("name", ["plaza"])
def test_the_result_on_an_example_is_as_good_as_the_golden_one(data, tmp_path, name):
    motion = track_capture(data / name, tmp_path / "result", frames=FRAMES, overlays=False)
    hold_against_golden(motion, data / name / "truth.npz", name)
