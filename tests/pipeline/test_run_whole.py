"""`run` with its own body, selected frames, tracking and report, on a synthetic film; time and cameras are given."""

from pathlib import Path

import numpy as np
import pytest

from jaxmocap.calibration import adopt_cameras
from jaxmocap.capture import config_path, with_offsets
from jaxmocap.character import stature
from jaxmocap.metrics import evaluate
from jaxmocap.pipeline import _run_footage, run
from jaxmocap.synthetic import make_capture, write_capture

pytestmark = pytest.mark.slow


def test_videos_and_keypoints_become_a_motion(tmp_path, monkeypatch):
    filmed = make_capture(4, (320, 180), fps=4.0, selected_frames=(0, 1, 2, 3))
    source = write_capture(filmed, tmp_path / "filmed")

    def sync(folder: Path, progress):
        file = config_path(folder)
        file.write_text(with_offsets(file.read_text(), [0.0, 0.0], file))
        return type("Found", (), {"notes": (), "record": lambda self: {"cameras": {}, "pairs": []}})()

    monkeypatch.setattr(_run_footage, "sync", sync)

    def calibrate(folder: Path, say, **_):
        adopt_cameras(folder, source / "cameras")
        return type("Found", (), {"record": {"warnings": []}})()

    monkeypatch.setattr(_run_footage, "calibrate_folder", calibrate)
    height = float(stature(filmed.character))
    said: list[str] = []
    result = run(
        [source / "cam0.mp4", source / "cam1.mp4"],
        tmp_path / "out",
        height=height,
        keypoints=source / "keypoints",
        quality="draft",
        detections=False,
        say=said.append,
    )
    assert list(result.seconds) == [
        "capture", "synchronise", "detect", "calibrate", "body", "selected frames", "track"
    ]  # fmt: skip
    assert result.report.is_file()
    assert float(stature(result.motion.character)) == pytest.approx(height, rel=0.01)
    assert any("made to measure at 4 frames" in sentence for sentence in said)
    scores = evaluate(result.folder, source / "truth.npz")
    assert scores["frames"] == 4
    assert scores["joint_error_cm"]["mean"] < 6
    assert np.array_equal(run(
        [source / "cam0.mp4", source / "cam1.mp4"], tmp_path / "out", height=height, keypoints=source / "keypoints",
        quality="draft", detections=False,
    ).motion.angles, result.motion.angles)  # fmt: skip
