import os
from types import SimpleNamespace

import av
import jax.numpy as jnp
import numpy as np
import pytest
from box_figure import box_character, box_motion

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras
from jaxmocap.viewers import overlay_videos, write_overlay_video


def _read(path):
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [(frame.time, frame.to_ndarray(format="rgb24")) for frame in container.decode(stream)]
        return stream.codec_context.name, stream.codec_context.pix_fmt, frames


def _ramp(width, height, colour):
    image = np.zeros((height, width, 3), np.uint8)
    image[:] = colour
    return image


def test_times_and_colours_survive_and_odd_sizes_are_made_even(tmp_path):
    times = [2.0, 2.01, 2.05, 2.2, 2.21]
    colours = [(200, 60, 60), (60, 200, 60), (60, 60, 200), (128, 128, 128), (250, 250, 250)]
    path = write_overlay_video(
        tmp_path / "a.mp4", ((t, _ramp(61, 45, colour)) for t, colour in zip(times, colours, strict=True))
    )
    codec, pixels, frames = _read(path)
    assert (codec, pixels) == ("h264", "yuv420p")
    assert np.allclose([t for t, _ in frames], np.array(times) - 2.0, atol=1e-4)
    for (_, image), colour in zip(frames, colours, strict=True):
        assert image.shape == (46, 62, 3)
        assert np.abs(image.astype(int) - colour).max() < 12
    assert os.listdir(tmp_path) == ["a.mp4"]


def test_a_failure_in_the_middle_leaves_no_file(tmp_path):
    def frames():
        yield 0.0, _ramp(32, 32, 0)
        yield 0.1, _ramp(32, 32, 9)
        raise RuntimeError("decoder died")

    with pytest.raises(RuntimeError, match="decoder died"):
        write_overlay_video(tmp_path / "a.mp4", frames())
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("frames", "sentence"),
    [
        ([], "at least one frame"),
        ([(0.0, (32, 32)), (0.0, (32, 32))], "the frame at 0 s does not come after"),
        ([(0.0, (32, 32)), (0.1, (34, 32))], r"shape \(32, 34, 3\) follows images of shape \(32, 32, 3\)"),
    ],
)
def test_impossible_videos_are_refused_and_leave_no_file(tmp_path, frames, sentence):
    with pytest.raises(InputError, match=sentence):
        write_overlay_video(tmp_path / "a.mp4", [(t, _ramp(*size, 0)) for t, size in frames])
    assert os.listdir(tmp_path) == []


def test_a_place_where_no_video_can_be_is_named(tmp_path):
    (tmp_path / "none").write_text("mine")
    with pytest.raises(InputError, match=r"none/a\.mp4 cannot be written"):
        write_overlay_video(tmp_path / "none/a.mp4", [(0.0, _ramp(32, 32, 0))])


@pytest.fixture
def scene():
    """Two cameras whose shared span starts at frame 4 of the first video; the second looks away from the figure."""
    away = np.diag([1.0, 1, 1, 1])
    facing = np.diag([1.0, -1, -1, 1])
    facing[1, 3], facing[2, 3] = 1.0, 4.0
    away[2, 3] = -50.0
    cameras = Cameras(
        names=("front", "away"),
        sizes=((120, 80), (120, 80)),
        intrinsics=jnp.tile(jnp.asarray([[100.0, 0, 60], [0, 100, 40], [0, 0, 1]]), (2, 1, 1)),
        distortion=jnp.zeros((2, 5)),
        cam_from_world=jnp.asarray(np.stack([facing, away])[:, None].repeat(6, 1)),
    )
    capture = SimpleNamespace(
        folder="capture",
        camera_names=cameras.names,
        sizes=cameras.sizes,
        video_frames=np.stack([np.arange(4, 10), np.arange(6)]),
        image=lambda camera, position: _ramp(120, 80, 20 * position),
    )
    return capture, cameras


def test_every_view_shows_the_images_of_the_motions_frames(scene, tmp_path):
    capture, cameras = scene
    motion = box_motion(box_character(), num_frames=8)[5:8]  # frames 5, 6, 7 are positions 1, 2, 3 of the capture
    paths = overlay_videos(capture, cameras, motion, tmp_path)
    assert [path.name for path in paths] == ["overlay_front.mp4", "overlay_away.mp4"]
    front, away = (_read(path)[2] for path in paths)
    assert len(front) == len(away) == 3
    for index, (_, image) in enumerate(away):
        assert np.abs(image[60:, 20:].astype(int) - 20 * (index + 1)).max() < 12
    assert (np.abs(front[0][1].astype(int) - away[0][1]).max(axis=-1) > 40).mean() > 0.02


def test_a_result_of_another_capture_is_refused(scene, tmp_path):
    capture, cameras = scene
    motion = box_motion(box_character(), num_frames=8)
    with pytest.raises(InputError, match=r"Frame 0 of the result is not among the frames .* \(4 to 9\)"):
        overlay_videos(capture, cameras, motion, tmp_path)
    assert os.listdir(tmp_path) == []
