"""The first guess of a focal length, from what phones write into their videos."""

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from jaxmocap.calibration._focal import told_focal
from jaxmocap.capture import index_video
from jaxmocap.capture.synchronisation._estimate import Undecided
from jaxmocap.capture.synchronisation._sound import read_sound

SIZE = (160, 90)
DIAGONAL = float(np.hypot(*SIZE))
KEY = "com.apple.quicktime.camera.focal_length.35mm_equivalent"


def video(path: Path, metadata: dict[str, str]) -> Path:
    """A video of two frames with metadata in the QuickTime keys that phones use."""
    with av.open(str(path), "w", options={"movflags": "use_metadata_tags"}) as container:
        container.metadata.update(metadata)
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        for number in range(2):
            frame = av.VideoFrame.from_ndarray(np.zeros((*SIZE[::-1], 3), np.uint8), format="rgb24")
            frame.pts, frame.time_base = number, Fraction(1, 30)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


@pytest.mark.parametrize("suffix", [".mov", ".mp4"])
@pytest.mark.parametrize(
    ("metadata", "millimetres"),
    [
        ({KEY: "26"}, 26.0),
        ({KEY: "13.5", "com.apple.quicktime.model": "phone"}, 13.5),
        ({"FocalLengthIn35mmFormat": "28 mm"}, 28.0),
    ],
)
def test_the_equivalent_focal_length_is_read(tmp_path, suffix, metadata, millimetres):
    """Equivalent means: the same angle over the diagonal as on 36 mm x 24 mm."""
    found = told_focal(video(tmp_path / f"phone{suffix}", metadata), SIZE)
    assert found == pytest.approx(millimetres / np.hypot(36, 24) * DIAGONAL, rel=1e-3)


@pytest.mark.parametrize("value", ["", "wide", "0", "5000", "nan"])
def test_nonsense_and_silence_tell_nothing(tmp_path, value):
    assert told_focal(video(tmp_path / "phone.mov", {KEY: value} if value else {}), SIZE) is None


def test_a_title_in_another_encoding_is_no_obstacle(tmp_path):
    """Players and editors write such; the sound is read in spite of it too."""
    path = video(tmp_path / "phone.mp4", {"title": "Grusse aus dem Park", KEY: "26"})
    content = path.read_bytes()
    assert content.count(b"Grusse") == 1
    path.write_bytes(content.replace(b"Grusse", b"Gr\xfc\xdfe "))
    assert told_focal(path, SIZE) is not None
    with pytest.raises(Undecided, match="has no sound"):
        read_sound(index_video(path))
