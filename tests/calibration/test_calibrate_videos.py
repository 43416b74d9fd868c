"""Calibrating a list of videos: a new capture, whole or not at all; and what is said of captures not synchronised."""

import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from filmed_square import SIZE, film_with_flash, walk, write_video
from moving_cameras import centres_of

import jaxmocap as jm
from jaxmocap._cli import run

COUNT, LATE = 30, 3
POSES = walk(COUNT + LATE)


@pytest.fixture(scope="module")
def videos(tmp_path_factory) -> list[Path]:
    """Two films of the square; the second began three frames later."""
    folder = tmp_path_factory.mktemp("videos")
    return [
        film_with_flash(folder / "left.mp4", POSES[0, :COUNT], flash=10),
        film_with_flash(folder / "right.mp4", POSES[1, LATE:], flash=10 - LATE),
    ]


def sentence(arguments: list[object], capsys) -> str:
    assert run(["calibrate", *map(str, arguments)]) == 2
    return next(line for line in capsys.readouterr().err.splitlines() if line.startswith("jaxmocap: "))


@pytest.mark.slow
def test_a_list_of_videos_becomes_a_calibrated_capture(videos, tmp_path):
    apart = float(np.linalg.norm(centres_of(POSES[0, LATE]) - centres_of(POSES[1, LATE])))
    out = tmp_path / "square"
    found = jm.calibrate(videos, out, camera_distance=apart, key_step=4)
    assert found.folder == out / "cameras"
    settings = tomllib.loads((out / "capture.toml").read_text())
    assert settings["cameras"] == "cameras"
    assert settings["camera"][1]["offset"] == pytest.approx(LATE / 30, abs=0.5 / 30)
    capture = jm.Capture.open(out)
    centres = np.asarray(capture.cameras.centres(), float)
    assert capture.num_frames == COUNT - LATE
    travelled = np.linalg.norm(centres[:, -1] - centres[:, 0], axis=-1)
    true = np.linalg.norm(centres_of(POSES[:, COUNT - 1]) - centres_of(POSES[:, LATE]), axis=-1)
    np.testing.assert_allclose(travelled, true, rtol=0.05)
    assert sorted(file.name for file in out.iterdir()) == [
        "cameras",
        "capture.toml",
        "left.mp4",
        "right.mp4",
        "sync.json",
    ]


def test_videos_alone_do_not_tell_their_scale(videos, tmp_path, capsys):
    assert "--camera-distance" in sentence([*videos, "--out", tmp_path / "new"], capsys)
    assert "give one capture folder" in sentence(videos, capsys)
    assert not (tmp_path / "new").exists()


def test_videos_that_cannot_be_calibrated_leave_no_folder(videos, tmp_path, capsys):
    """They can be synchronised by the flash, and then the second shows nothing else."""

    def light(number: int) -> np.ndarray:
        return np.full((*SIZE[::-1], 3), 200 if number == 7 else 20, np.uint8)

    dark = write_video(tmp_path / "dark.mp4", COUNT, light)
    said = sentence([videos[0], dark, "--out", tmp_path / "new", "--camera-distance", 2], capsys)
    assert "'dark' cannot be calibrated" in said
    assert [path.name for path in tmp_path.iterdir()] == ["dark.mp4"]
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "notes.txt").touch()
    said = sentence([*videos, "--out", tmp_path / "new", "--camera-distance", 2], capsys)
    assert "exists already" in said


def test_a_capture_without_offsets_is_told_to_be_synchronised(videos, tmp_path, capsys):
    for video in videos:
        shutil.copyfile(video, tmp_path / video.name)
    lines = [f'[[camera]]\nname = "{video.stem}"\nvideo = "{video.name}"\n' for video in videos]
    toml = tmp_path / "capture.toml"
    toml.write_text("".join(lines))
    assert run(["calibrate", str(tmp_path)]) == 2  # nothing tells the scale
    assert "jaxmocap sync" in capsys.readouterr().err
    toml.write_text("".join(line + "offset = 0.0\n" for line in lines))
    assert run(["calibrate", str(tmp_path)]) == 2
    assert "jaxmocap sync" not in capsys.readouterr().err
