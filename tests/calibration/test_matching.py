"""Which pictures are matched with each other, and the features in them."""

import cv2
import numpy as np
import pytest
from small_captures import make_video

from jaxmocap.calibration._features import detect, match
from jaxmocap.calibration._footage import Footage, footage_of
from jaxmocap.calibration._matching import frame_pairs, key_pairs
from jaxmocap.capture import Capture

FAST, SLOW = 60, 30  # pictures a second
LATER = 0.5  # seconds by which the slow camera began later


@pytest.fixture(scope="module")
def footage(tmp_path_factory) -> Footage:
    """Four seconds of two phones, one of which takes twice as many pictures."""
    folder = tmp_path_factory.mktemp("rates") / "capture"
    folder.mkdir()
    make_video(folder / "fast.mp4", 4 * FAST, fps=FAST)
    make_video(folder / "slow.mp4", 4 * SLOW, fps=SLOW)
    cameras = "".join(
        f'[[camera]]\nname = "{name}"\nvideo = "{name}.mp4"\noffset = {offset}\n'
        for name, offset in (("fast", 0.0), ("slow", LATER))
    )
    (folder / "capture.toml").write_text(cameras)
    return footage_of(Capture.open(folder), None, key_step=5, threads=1, seed=0)


def moment(place: tuple[int, int]) -> float:
    camera, frame = place
    return frame / FAST if camera == 0 else LATER + frame / SLOW


def test_pictures_of_two_cameras_are_paired_by_time_whatever_their_rates(footage):
    across = [(one, other) for one, other in key_pairs(footage) if one[0] != other[0]]
    for frame in footage.key_frames(0):
        partners = [moment(other) for one, other in across if one == (0, frame)]
        at = np.clip(moment((0, frame)), LATER, LATER + 4 - 1 / SLOW)
        assert min(abs(time - at) for time in partners) < 5 / SLOW
        assert max(abs(time - at) for time in partners) < 1.6  # nine key frames, five pictures apart


def test_a_picture_between_is_placed_by_those_taken_nearest_to_it(footage):
    for camera, frame in ((0, 123), (1, 61)):
        for other in frame_pairs(footage, camera, frame):
            assert abs(moment(other) - moment((camera, frame))) < 10 / SLOW


def test_what_the_child_process_reads_is_what_was_written(footage, tmp_path):
    file = tmp_path / "job.json"
    file.write_text(footage.to_json())
    assert Footage.from_file(file) == footage


def test_large_pictures_are_searched_smaller_and_their_points_lie_where_they_are():
    """The points of a picture of 3840 pixels are those of the one of 960 that it was made of, four times as far out."""
    generator = np.random.default_rng(3)
    noise = generator.integers(0, 255, (135, 240), dtype=np.uint8)
    small = cv2.cvtColor(cv2.resize(noise, (960, 540), interpolation=cv2.INTER_CUBIC), cv2.COLOR_GRAY2RGB)
    large = cv2.resize(small, (3840, 2160), interpolation=cv2.INTER_NEAREST)
    person = np.zeros((540, 960), bool)
    person[:, :200] = True
    found = detect(small, person, 300)
    again = detect(large, np.kron(person, np.ones((4, 4), bool)), 300)
    pairs = match(found, again)
    assert len(pairs) == len(found.points) > 100
    np.testing.assert_allclose(again.points[pairs[:, 1]], 4 * found.points[pairs[:, 0]], atol=0.2)
    assert again.points[:, 0].min() > 4 * 190
