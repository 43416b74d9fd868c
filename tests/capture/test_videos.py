import gc
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from small_captures import make_video, number_of, picture

from jaxmocap._results import InputError
from jaxmocap.capture import shared_frames
from jaxmocap.capture._video import FrameReader, index_video, luma_frames


def test_every_frame_is_found_going_forward_backward_and_jumping(tmp_path: Path):
    index = index_video(make_video(tmp_path / "a.mp4", 70))
    reader = FrameReader(index)
    order = [*range(70), *range(69, -1, -7), 3, 68, 3, 4, 4, 66, 0]
    assert [number_of(reader.read(frame)) for frame in order] == order
    reader.close()


def test_the_index_equals_the_decoded_timestamps_of_a_variable_rate_video(tmp_path: Path):
    milliseconds = [0, 33, 70, 81, 140, 175, 301, 334, 350, 402]
    index = index_video(make_video(tmp_path / "a.mp4", milliseconds=milliseconds))
    np.testing.assert_allclose(index.seconds, np.array(milliseconds) / 1000, atol=1e-6)
    reader = FrameReader(index)
    assert [number_of(reader.read(frame)) for frame in range(10)] == list(range(10))
    reader.close()


def test_times_count_from_the_first_frame_when_the_stream_starts_late(tmp_path: Path):
    index = index_video(make_video(tmp_path / "a.mkv", milliseconds=[500, 540, 600, 660]))
    np.testing.assert_allclose(index.seconds, [0, 0.04, 0.1, 0.16], atol=1e-6)


def test_an_avi_without_b_frames_is_read(tmp_path: Path):
    index = index_video(make_video(tmp_path / "a.avi", 9, codec="mpeg4"))
    np.testing.assert_allclose(index.seconds, np.arange(9) / 30, atol=1e-6)
    reader = FrameReader(index)
    assert [number_of(reader.read(frame)) for frame in (0, 5, 8, 2)] == [0, 5, 8, 2]
    reader.close()


@pytest.mark.parametrize("name", ["a.avi", "a.h264"])
def test_containers_that_do_not_say_when_frames_are_shown_are_refused(tmp_path: Path, name: str):
    with pytest.raises(InputError, match=rf"{name} does not tell when each of its frames is shown; convert it to MP4"):
        index_video(make_video(tmp_path / name, 9))


@pytest.mark.parametrize(("rotation", "turns"), [(90, 1), (-90, 3), (180, 2)])
def test_rotation_in_the_metadata_is_applied_to_pictures_and_size(tmp_path: Path, rotation: int, turns: int):
    index = index_video(make_video(tmp_path / "a.mp4", 3, rotation=rotation))
    expected = np.rot90(picture(2), turns)  # the metadata turns counter-clockwise
    assert index.size == expected.shape[1::-1]
    reader = FrameReader(index)
    assert np.abs(reader.read(2).astype(int) - expected).mean() < 6
    reader.close()


@pytest.mark.parametrize(
    ("display", "shown"),
    [
        ((-1, 0, 0, 1), np.fliplr),
        ((1, 0, 0, -1), np.flipud),
        ((0, 1, 1, 0), lambda stored: stored.swapaxes(0, 1)),
        ((0, -1, -1, 0), lambda stored: np.rot90(stored, 2).swapaxes(0, 1)),
    ],
)
def test_a_mirror_in_the_metadata_is_applied_too(tmp_path: Path, display: tuple[int, ...], shown):
    index = index_video(make_video(tmp_path / "a.mp4", 3, display=display))
    expected = shown(picture(2))
    assert index.size == expected.shape[1::-1]
    reader = FrameReader(index)
    assert np.abs(reader.read(2).astype(int) - expected).mean() < 6
    reader.close()
    _, stored = list(luma_frames(index))[2]
    assert np.abs(index.upright(stored).astype(int) - expected.mean(-1)).mean() < 20


def test_brightness_is_read_in_one_pass_as_it_is_stored(tmp_path: Path):
    index = index_video(make_video(tmp_path / "a.mp4", 9, milliseconds=range(0, 270, 30), rotation=90, first=5))
    frames = list(luma_frames(index))
    assert [number for number, _ in frames] == list(range(9))
    assert [number_of(np.repeat(luma[..., None], 3, axis=2)) for _, luma in frames] == list(range(5, 14))
    path = tmp_path / "b.mp4"
    index = index_video(make_video(path, 40))
    path.unlink()
    with pytest.raises(InputError, match=r"b\.mp4 does not exist"):
        list(luma_frames(index))


def test_colours_survive_decoding_as_rgb(tmp_path: Path):
    reader = FrameReader(index_video(make_video(tmp_path / "a.mp4", 2)))
    image = reader.read(1)
    assert image.dtype == np.uint8
    np.testing.assert_allclose(image[42, 12], (200, 30, 30), atol=12)
    np.testing.assert_allclose(image[42, 52], (30, 160, 30), atol=12)
    reader.close()


def test_a_frame_outside_the_video_is_an_index_error(tmp_path: Path):
    reader = FrameReader(index_video(make_video(tmp_path / "a.mp4", 3)))
    with pytest.raises(IndexError, match=r"a\.mp4 has frames 0\.\.2, not 3"):
        reader.read(3)
    reader.close()


@pytest.mark.parametrize(
    ("content", "sentence"),
    [(None, "does not exist"), (b"", "cannot be opened"), (b"not a video" * 50, "cannot be opened")],
)
def test_files_that_are_no_videos_are_refused_by_name(tmp_path: Path, content: bytes | None, sentence: str):
    path = tmp_path / "broken.mp4"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=rf"broken\.mp4.*{sentence}"):
        index_video(path)


def test_a_file_with_sound_only_is_refused(tmp_path: Path):
    import wave

    with wave.open(str(tmp_path / "a.wav"), "wb") as sound:
        sound.setparams((1, 2, 8000, 0, "NONE", ""))
        sound.writeframes(bytes(1600))
    with pytest.raises(InputError, match=r"a\.wav has no video stream"):
        index_video(tmp_path / "a.wav")


def test_a_video_cut_off_in_the_middle_names_the_frame_that_cannot_be_decoded(tmp_path: Path):
    path = make_video(tmp_path / "a.mkv", 40)
    index = index_video(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    reader = FrameReader(index)
    with pytest.raises(InputError, match=r"a\.mkv frame 39 cannot be decoded"):
        reader.read(39)
    reader.close()


def test_reading_forward_holds_one_frame_whatever_the_length(tmp_path: Path):
    def peak(count: int) -> int:
        reader = FrameReader(index_video(make_video(tmp_path / f"{count}.mp4", count, size=(320, 240))))
        gc.collect()
        tracemalloc.start()
        for frame in range(count):
            reader.read(frame)
        used = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        reader.close()
        return used

    picture_size = 320 * 240 * 3
    assert peak(90) < peak(15) + picture_size


def _times(tmp_path: Path, name: str, milliseconds: list[int]):
    return index_video(make_video(tmp_path / name, milliseconds=milliseconds))


def test_frames_are_matched_by_nearest_time_not_by_number(tmp_path: Path):
    first = _times(tmp_path, "a.mp4", [0, 40, 80, 120, 160])
    double = _times(tmp_path, "b.mp4", [0, 20, 40, 60, 80, 100, 120, 140, 160])
    uneven = _times(tmp_path, "c.mp4", [0, 10, 50, 130, 150])
    shared = shared_frames([first, double, uneven], [0.0, 0.0, 0.0])
    np.testing.assert_array_equal(shared, [[0, 1, 2, 3, 4], [0, 2, 4, 6, 8], [0, 2, 2, 3, 4]])


def test_an_offset_moves_a_video_and_the_span_shrinks_to_what_all_see(tmp_path: Path):
    first = _times(tmp_path, "a.mp4", [0, 40, 80, 120, 160, 200])
    late = _times(tmp_path, "b.mp4", [0, 40, 80, 120])
    shared = shared_frames([first, late], [0.0, 0.080])  # b's first picture is a's frame 2
    np.testing.assert_array_equal(shared, [[2, 3, 4, 5], [0, 1, 2, 3]])


def test_videos_that_never_overlap_are_refused_with_their_spans(tmp_path: Path):
    first, second = (_times(tmp_path, name, [0, 40, 80]) for name in ("a.mp4", "b.mp4"))
    with pytest.raises(InputError, match=r"a\.mp4 0\.000 to 0\.080 s, b\.mp4 9\.000 to 9\.080 s"):
        shared_frames([first, second], [0.0, 9.0])
