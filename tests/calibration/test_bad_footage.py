"""Footage that cannot be calibrated, through the command line: one sentence, exit code 2, and nothing changed."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from filmed_square import SIZE, TEXTURES, TOML, picture, walk, write_video

from jaxmocap._cli import run
from jaxmocap._results import InputError
from jaxmocap.calibration._calibrate import _refuse_loose_cameras

COUNT = 24
POSES = walk(COUNT)


def elsewhere(number: int) -> np.ndarray:
    """Another place, over which the camera pans."""
    noise = np.random.default_rng(5).integers(0, 255, (90, 160, 3), np.uint8).repeat(3, 0).repeat(3, 1)
    return np.roll(noise, 2 * number, axis=1)


def square(camera: int, poses: np.ndarray = POSES) -> Callable[[int], np.ndarray]:
    return lambda number: picture(poses[camera, number])


def person_alone(number: int, seed: int = 0) -> np.ndarray:
    """Trunk, head, arms and legs, each patterned and each swinging by itself, before a white wall."""
    image = np.full((*SIZE[::-1], 3), 225, np.uint8)
    trunk, head, arms = (240, 120, 30, 45), (240, 55, 14, 18), ((195, 110, 10, 35), (285, 110, 10, 35))
    parts = (trunk, head, *arms, (225, 205, 12, 42), (255, 205, 12, 42))
    for part, (x, y, half_width, half_height) in enumerate(parts):
        angle = 40 * np.sin(number / 9 + 1.7 * part + seed) * (part > 1)
        texels = TEXTURES[part % 4][100 * part : 100 * part + 2 * half_height, : 2 * half_width]
        place = cv2.getRotationMatrix2D((half_width, 0), angle, 1.0)
        place[:, 2] += (x - half_width + 25 * np.sin(number / 25), y - half_height + 6 * np.sin(number / 7 + part))
        shown = cv2.warpAffine(texels, place, SIZE)
        covered = cv2.warpAffine(np.full_like(texels, 255), place, SIZE) > 128
        image[covered] = shown[covered][:, None]
    return image


def refused(folder: Path, capsys, *options: object, count: int = COUNT, images: dict[str, Callable]) -> str:
    """The sentence with which the capture of these two films is refused, after which it is as it was."""
    folder.mkdir()
    for name, image in images.items():
        write_video(folder / f"{name}.mp4", count, image)
    (folder / "capture.toml").write_text(TOML)
    before = {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}
    assert run(["calibrate", str(folder), "--camera-distance", "2", *map(str, options)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "Traceback" not in err
    assert {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()} == before
    sentences = [line for line in err.splitlines() if line.startswith("jaxmocap: ")]
    assert len(sentences) == 1
    return sentences[0]


@pytest.mark.slow
def test_a_black_video(tmp_path, capsys):
    images = {"cam0": square(0), "cam1": lambda number: np.zeros((*SIZE[::-1], 3), np.uint8)}
    assert "'cam1' cannot be calibrated" in refused(tmp_path / "black", capsys, images=images)


@pytest.mark.slow
def test_cameras_that_see_different_places(tmp_path, capsys):
    images = {"cam0": square(0), "cam1": elsewhere}
    assert "'cam1' shares no background" in refused(tmp_path / "apart", capsys, images=images)


@pytest.mark.slow
@pytest.mark.parametrize("cut", [6, 18])
def test_a_video_that_cuts_to_another_place(tmp_path, capsys, cut):
    images = {"cam0": square(0), "cam1": lambda number: (square(1) if number < cut else elsewhere)(number)}
    said = refused(tmp_path / "cut", capsys, "--key-step", 3, images=images)
    assert "cam1" in said
    assert "cut" in said


@pytest.mark.slow
def test_twelve_seconds_of_nothing_but_the_person(tmp_path, capsys):
    images = {"cam0": person_alone, "cam1": lambda number: person_alone(number, seed=1)}
    said = refused(tmp_path / "alone", capsys, count=360, images=images)
    assert "cannot be calibrated" in said or "too little background" in said


def test_cameras_whose_directions_are_open_are_refused():
    cameras = {"cam0": {"rotation_deviation_degrees": 0.2}, "cam1": {"rotation_deviation_degrees": 306.0}}
    capture = SimpleNamespace(name="alone")
    with pytest.raises(InputError, match="direction of cam1 open by 306 degrees"):
        _refuse_loose_cameras(capture, {"cameras": cameras})
    _refuse_loose_cameras(capture, {"cameras": cameras | {"cam1": {"rotation_deviation_degrees": 2.0}}})


def test_two_phones_that_lie_still(tmp_path, capsys):
    still = np.repeat(POSES[:, :1], COUNT, axis=1)
    images = {"cam0": square(0, still), "cam1": square(1, still)}
    said = refused(tmp_path / "still", capsys, images=images)
    assert "cameras that stand still are placed by the person's keypoints" in said
    assert "run jaxmocap detect" in said
