"""Whole calibrations of small textured films, and of the raw example; what is refused; crashes of the child."""

import json
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from filmed_square import FOCAL, SIZE, TOML, film, walk, write_video
from moving_cameras import centres_of

from jaxmocap._cli import run
from jaxmocap._results import InputError
from jaxmocap.calibration import _calibrate, calibrate
from jaxmocap.calibration._child import run_worker
from jaxmocap.calibration._footage import footage_of
from jaxmocap.calibration._matching import key_pairs, match_key_frames
from jaxmocap.calibration._subject import keypoints_of
from jaxmocap.calibration._trajectory import find_outliers
from jaxmocap.capture import Capture, with_cameras_line
from jaxmocap.geometry import align_cameras, camera_residuals

COUNT = 12
POSES = walk(COUNT)


@pytest.fixture(scope="module")
def square(tmp_path_factory) -> Path:
    return film(tmp_path_factory.mktemp("films") / "square", POSES)


def silent(stage: str, done: int, total: int) -> None:
    pass


def distance() -> float:
    return float(np.linalg.norm(centres_of(POSES[0, 0]) - centres_of(POSES[1, 0])))


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def refused(arguments: list[object], capsys) -> str:
    assert run(["calibrate", *map(str, arguments)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    sentences = [line for line in err.splitlines() if line.startswith("jaxmocap: ")]
    assert len(sentences) == 1
    assert "Traceback" not in err
    return sentences[0]


def test_a_filmed_square_is_calibrated_in_place(square, capsys, monkeypatch):
    """The only whole run among the quick tests, with fewer features than are looked for by default."""
    few = lambda *job: replace(footage_of(*job), num_features=1500)  # noqa: E731
    monkeypatch.setattr(_calibrate, "footage_of", few)
    before = files_of(square)
    assert run(["calibrate", str(square), "--camera-distance", str(distance()), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    text = (square / "capture.toml").read_text()
    assert text.replace('cameras = "cameras"\n', "") == TOML
    assert {name: data for name, data in files_of(square).items() if name in before and name != "capture.toml"} == {
        name: data for name, data in before.items() if name != "capture.toml"
    }
    capture = Capture.open(square)
    found = np.asarray(capture.cameras.cam_from_world, float).reshape(-1, 4, 4)
    similarity = align_cameras(found, POSES.reshape(-1, 4, 4))
    centres, angles = camera_residuals(similarity, found, POSES.reshape(-1, 4, 4))
    assert centres.max() < 0.04
    assert np.degrees(angles).max() < 0.4
    np.testing.assert_allclose(np.asarray(capture.cameras.intrinsics)[:, 0, 0], FOCAL, rtol=0.02)
    assert similarity.scale == pytest.approx(1.0, abs=0.02)
    assert np.degrees(np.arccos((similarity.rotation @ [0, 1, 0])[1])) < 1.5
    for name in ("cam0", "cam1"):
        assert answer["cameras"][name]["registered"] == COUNT
        assert answer["cameras"][name]["interpolated"] == []
    record = json.loads((square / "cameras" / "calibration.json").read_text())
    assert record == {key: value for key, value in answer.items() if key != "folder"}
    table = json.loads((square / "cameras" / "uncertainty.json").read_text())
    assert table["cam1"]["frame"] == list(range(COUNT))
    assert all(0 < value < 0.05 for value in table["cam0"]["centre_deviation"])
    assert (square / "cameras" / "calibration.png").read_bytes()[:4] == b"\x89PNG"


def test_cameras_that_are_there_are_not_replaced_unasked(square, tmp_path, capsys):
    folder = tmp_path / "copy"
    folder.mkdir()
    (folder / "capture.toml").write_text('cameras = "rig.toml"\n' + TOML)
    sentence = refused([folder], capsys)
    assert "names cameras already ('rig.toml')" in sentence
    assert "--replace" in sentence


def test_a_capture_whose_scale_nothing_tells_is_refused_before_the_long_run(square, tmp_path, capsys):
    for video in ("cam0.mp4", "cam1.mp4"):
        (tmp_path / video).symlink_to(square / video)
    (tmp_path / "capture.toml").write_text(TOML)
    assert "--height" in refused([tmp_path], capsys)
    assert "--camera-distance" in refused([tmp_path, "--height", 1.8], capsys)
    assert "metres" in refused([tmp_path, "--height", 180], capsys)
    assert "CAMERA=PIXELS" in refused([tmp_path, "--focal", "900"], capsys)
    assert "cam7" in refused([tmp_path, "--focal", "cam7=900"], capsys)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["cam0.mp4", "cam1.mp4", "capture.toml"]


def test_keypoints_beyond_the_frames_that_are_wanted_do_not_tell_the_scale(square, tmp_path, capsys):
    for video in ("cam0.mp4", "cam1.mp4"):
        (tmp_path / video).symlink_to(square / video)
    (tmp_path / "capture.toml").write_text('keypoints = "keypoints"\n' + TOML)
    (tmp_path / "keypoints").mkdir()
    person = json.dumps({"people": [{"pose_keypoints_2d": [100.0, 100.0, 0.9] * 25}]})
    for name in ("cam0", "cam1"):
        (tmp_path / "keypoints" / f"{name}_{8:05d}_keypoints.json").write_text(person)
    said = refused([tmp_path, "--height", 1.8, "--frames", "0:8"], capsys)
    assert "no frame with keypoints of the person's limbs in two cameras among those wanted (at best 0 bones" in said
    capture = Capture.open(tmp_path, with_cameras=False)
    assert list(keypoints_of(capture, range(COUNT))) == [8]
    assert keypoints_of(capture, range(8)) == {}


def two(tmp_path: Path, square: Path, second: Path) -> Capture:
    """A capture of the square's first video and another one."""
    (tmp_path / "cam0.mp4").symlink_to(square / "cam0.mp4")
    (tmp_path / "cam1.mp4").symlink_to(second)
    (tmp_path / "capture.toml").write_text(TOML)
    return Capture.open(tmp_path)


def test_a_black_video_and_one_of_another_place_are_refused(square, tmp_path):
    black = write_video(tmp_path / "black.mp4", COUNT, lambda number: np.zeros((*SIZE[::-1], 3), np.uint8))
    noise = np.random.default_rng(5).integers(0, 255, (90, 160, 3), np.uint8).repeat(3, 0).repeat(3, 1)
    other = write_video(tmp_path / "other.mp4", COUNT, lambda number: np.roll(noise, number, axis=1))
    steps: list[tuple[str, int, int]] = []
    for name, video, words in (("a", black, "'cam1'.* 0 points"), ("b", other, "'cam1' shares no background")):
        (tmp_path / name).mkdir()
        footage = replace(footage_of(two(tmp_path / name, square, video), None, (0, COUNT), 5, 0), num_features=600)
        with pytest.raises(InputError, match=words):
            match_key_frames(footage, tmp_path / name / "database.db", lambda *step: steps.append(step))
    matched = [done for stage, done, _ in steps if stage == "matching key frames"]
    assert matched[-1] == sum(one[0] != other[0] for one, other in key_pairs(footage))  # none within a camera


def test_nothing_but_the_person_is_refused(square, tmp_path):
    footage = footage_of(Capture.open(square, with_cameras=False), None, (0, COUNT), 5, 0)
    everywhere = {frame: (0.0, 0.0, *map(float, SIZE)) for frame in range(COUNT)}
    footage = replace(footage, videos=(footage.videos[0], replace(footage.videos[1], boxes=everywhere)))
    with pytest.raises(InputError, match=r"'cam1'.* outside the person"):
        match_key_frames(footage, tmp_path / "database.db", silent)


@pytest.mark.slow
def test_phones_that_stand_still_are_refused_unless_their_focal_length_is_known(tmp_path):
    still = film(tmp_path / "still", np.repeat(walk(2)[:, :1], COUNT, axis=1))
    capture = Capture.open(still)
    before = files_of(still)
    with pytest.raises(InputError, match=r"did not move|cannot be calibrated"):
        calibrate(capture, camera_distance=distance(), static=False)
    assert files_of(still) == before
    known = calibrate(capture, camera_distance=distance(), static=False, focal={"cam0": FOCAL, "cam1": FOCAL})
    found = np.asarray(known.cameras.cam_from_world, float).reshape(-1, 4, 4)
    true = np.repeat(POSES[:, :1], COUNT, axis=1).reshape(-1, 4, 4)
    _, angles = camera_residuals(align_cameras(found, true), found, true)
    assert np.degrees(angles).max() < 0.5


def test_a_crash_of_the_child_is_one_sentence_and_a_bug_is_a_traceback(tmp_path, monkeypatch):
    crash = tmp_path / "crash"
    crash.write_text("#!/bin/sh\nkill -SEGV $$\n")
    crash.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(crash))
    with pytest.raises(InputError, match=r"a crash .SIGSEGV."):
        run_worker("reconstruct", tmp_path, silent)
    monkeypatch.undo()
    with pytest.raises(RuntimeError, match=r"job\.json"):
        run_worker("reconstruct", tmp_path, silent)


def test_the_line_of_the_cameras_is_set_and_nothing_else():
    file = Path("capture.toml")
    for text in (TOML, TOML.replace("\n", "\r\n"), '[[camera]]\nname = "a"\nvideo = "a.mp4"', "frames = ?\n" + TOML):
        edited = with_cameras_line(text, "cameras", file)
        assert tomllib.loads(edited.replace("frames = ?\n", ""))["cameras"] == "cameras"
        assert [line for line in edited.splitlines() if not line.startswith("cameras")] == text.splitlines()
        again = with_cameras_line(edited, "cameras-2", file)
        assert again == edited.replace('"cameras"', '"cameras-2"')
    kept = with_cameras_line("cameras = 'rig.toml'  # measured\n" + TOML, "cameras", file)
    assert kept.startswith('cameras = "cameras"  # measured\n')
    assert with_cameras_line('cameras = """\nrig"""\n' + TOML, "cameras", file) == 'cameras = "cameras"\n' + TOML
    with pytest.raises(InputError, match=r"capture\.toml is not valid TOML"):
        with_cameras_line('cameras = "rig', "cameras", file)


@pytest.mark.slow
def test_the_raw_example_is_calibrated_to_centimetres(data):
    """Two moving phones and a dancer, 196 frames: minutes."""
    capture = Capture.open(data / "plaza_raw")
    capture = replace(capture, video_frames=np.stack([np.arange(4, 100), np.arange(96)]), num_frames=96)
    found = calibrate(capture)
    with np.load(data / "plaza_raw" / "truth.npz") as truth:
        true, focal = truth["cam_from_world"][:, 4:].reshape(-1, 4, 4), truth["K"][:, 0, 0]
    poses = np.asarray(found.cameras.cam_from_world, float)
    similarity = align_cameras(poses.reshape(-1, 4, 4), true)
    centres, angles = camera_residuals(similarity, poses.reshape(-1, 4, 4), true)
    assert centres.mean() < 0.02
    assert centres.max() < 0.06
    assert np.degrees(angles.mean()) < 0.4
    assert similarity.scale == pytest.approx(1.0, abs=0.02)
    assert np.degrees(np.arccos((similarity.rotation @ [0, 1, 0])[1])) < 1.5
    np.testing.assert_allclose(np.asarray(found.cameras.intrinsics)[:, 0, 0], focal, rtol=0.01)
    for camera in found.record["cameras"].values():
        assert camera["interpolated"] == []
    for path in poses:
        assert not find_outliers(np.arange(96.0), path, 5.0).outlier.any()
