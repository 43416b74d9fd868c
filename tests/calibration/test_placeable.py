"""A camera that is lost in a part of the footage: which part is advised, and that it works."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from filmed_square import SIZE, TOML, picture, walk, write_video

from jaxmocap._cli import run
from jaxmocap._results import InputError
from jaxmocap.calibration import refuse_gaps
from jaxmocap.calibration._footage import Footage, VideoFootage
from jaxmocap.calibration._placeable import advise_keys, advise_part


def video(first: int, last: int, wanted: range) -> VideoFootage:
    return VideoFootage(
        "cam", "", (960, 540), first, last, tuple(range(last - first + 1)), 900.0, False, False, {}, {},
        wanted=tuple(wanted),
    )  # fmt: skip


def test_the_longest_part_in_which_all_can_be_placed_is_advised_in_shared_frames():
    usable = np.zeros(60, bool)
    usable[5:17], usable[20:50] = True, True
    assert advise_part(usable, 100) == (
        "take shared frames 120 to 149 alone, in which all can be placed, with --frames 120:150"
    )
    assert advise_part(~np.zeros(60, bool), 0) == ""
    assert advise_part(np.arange(60) < 9, 0) == ""  # too short to be worth it


def test_frames_between_key_frames_of_which_one_is_lost_are_not_advised():
    """The second video began 7 frames earlier; its last usable key frame is 45, shared frame 38."""
    footage = Footage((video(0, 79, range(80)), video(0, 86, range(7, 87))), key_step=5)
    assert footage.wanted_key_frames(1) == [*range(10, 86, 5), 86]
    assert "--frames 0:39" in advise_keys(footage, {1: range(0, 46, 5)})
    assert "--frames 15:39" in advise_keys(footage, {0: range(11, 80), 1: range(0, 46, 5)})
    part = Footage((video(0, 79, range(20, 80)), video(0, 86, range(27, 87))), key_step=5, first_wanted=20)
    assert "--frames 20:39" in advise_keys(part, {1: range(0, 46, 5)})


def test_a_gap_says_which_frames_to_take_instead():
    frames = np.stack([np.arange(40), np.arange(40) + 3])
    capture = SimpleNamespace(camera_names=("left", "right"), video_frames=frames, fps=30.0)
    lost = {(1, frame) for frame in range(28, 43)}
    with pytest.raises(
        InputError, match=r"'right' cannot be placed in 15 of 40 .* its frames 28 to 42 on end.*, with --frames 0:25,"
    ):
        refuse_gaps(capture, lost, (0, None))
    refuse_gaps(capture, lost, (0, 25))
    refuse_gaps(capture, lost, (40, None))


@pytest.mark.slow
@pytest.mark.parametrize("shown", ["dark", "the ceiling"])
def test_a_phone_that_is_laid_down_halfway_is_named_with_the_frames_that_work(shown, tmp_path, capsys):
    count, poses = 36, walk(36)
    ceiling = np.random.default_rng(5).integers(0, 255, (90, 160, 3), np.uint8).repeat(3, 0).repeat(3, 1)
    lying = np.zeros((*SIZE[::-1], 3), np.uint8) if shown == "dark" else ceiling
    write_video(tmp_path / "cam0.mp4", count, lambda number: picture(poses[0, number]))
    write_video(tmp_path / "cam1.mp4", count, lambda number: picture(poses[1, number]) if number < 18 else lying)
    (tmp_path / "capture.toml").write_text(TOML)
    calibrate = ["calibrate", str(tmp_path), "--camera-distance", "2", "--focal", "cam0=430", "cam1=430"]
    calibrate += ["--key-step", "3"]
    assert run(calibrate) == 2
    sentence = capsys.readouterr().err.splitlines()[-1]
    assert re.search(r"cam1.* its frames 18 to 35", sentence)
    advised = re.search(
        r"take shared frames 0 to 1\d alone, in which all can be placed, with (--frames) (0:1\d)", sentence
    )
    assert advised is not None
    assert run([*calibrate, *advised.groups()]) == 0
    record = json.loads((tmp_path / "cameras" / "calibration.json").read_text())
    assert record["cameras"]["cam1"]["interpolated"][-1] == count - 1
    assert record["cameras"]["cam1"]["rotation_deviation_degrees"] < 1
