"""A capture without an actor: the built-in body is made to the measure of the person filmed, whose bones are known."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap._cli import run
from jaxmocap._results import InputError
from jaxmocap.camera import project, write_cameras
from jaxmocap.capture import KEYPOINT_NAMES, SILHOUETTES, Capture, mask_file
from jaxmocap.character import BodyShape, bone_lengths, landmark_positions, scaled, stature
from jaxmocap.pipeline import MadeBody, _made_to_measure, character_of, no_actor
from jaxmocap.registration import fit_character
from jaxmocap.rigging import body
from jaxmocap.synthetic import SyntheticCapture, make_capture, write_capture

FRAMES = (0, 1, 2, 3)


@pytest.fixture(scope="module")
def filmed():
    return make_capture(len(FRAMES), (192, 108), 2, fps=2.0, selected_frames=FRAMES)


@pytest.fixture(scope="module")
def folder(filmed, tmp_path_factory) -> Path:
    """Four poses half a second apart."""
    return unnamed(filmed, tmp_path_factory.mktemp("unnamed") / "capture")


@pytest.fixture(scope="module")
def all_round():
    """One pose from eight sides."""
    return make_capture(1, (192, 108), 8, view_angle_degrees=45.0, selected_frames=(0,))


def unnamed(filmed: SyntheticCapture, place: Path) -> Path:
    """Write a capture with exact keypoints and without actor, masks and selected frames."""
    folder = write_capture(filmed, place)
    toml = (folder / "capture.toml").read_text()
    left_out = ("actor", "masks", "selected_frames")
    lines = [line for line in toml.splitlines() if not line.startswith(left_out)]
    (folder / "capture.toml").write_text("\n".join(lines) + "\n")
    skeleton = filmed.character.skeleton
    for frame in filmed.selected_frames:
        at = dict(zip(skeleton.landmark_names, np.array(landmark_positions(skeleton, filmed.pose(frame))), strict=True))
        at["pelvis"], at["neck"] = at["mid_hip"], at["mid_shoulder"]
        points, view = jnp.asarray([at[name] for name in KEYPOINT_NAMES], jnp.float32), filmed.cameras.at(frame)
        for camera in range(len(filmed.cameras.names)):
            pixels, _ = project(view.intrinsics[camera], view.cam_from_world[camera], points)
            values = np.concatenate([np.asarray(pixels), np.full((25, 1), 0.8)], 1).ravel().tolist()
            file = folder / "keypoints" / f"cam{camera}_{frame:05d}_keypoints.json"
            file.write_text(json.dumps({"people": [{"pose_keypoints_2d": values}]}))
    return folder


def spoilt(folder: Path, to: Path, *edits: tuple[str, str], frames: int = 9) -> Capture:
    """A copy with another `capture.toml` and keypoints at so many frames alone."""
    copy = Path(shutil.copytree(folder, to / "copy"))
    text = (copy / "capture.toml").read_text()
    for before, after in edits:
        assert before in text
        text = text.replace(before, after)
    (copy / "capture.toml").write_text(text)
    for file in (copy / "keypoints").iterdir():
        if int(file.name.split("_")[1]) >= frames:
            file.unlink()
    return Capture.open(copy)


@pytest.mark.slow
def test_a_height_that_is_known_is_kept_whatever_the_start(folder, filmed):
    """Of bodies that differ in size and proportions, for the height is the person's, not the start's."""
    tall = float(stature(filmed.character))
    capture = Capture.open(folder)
    generic = scaled(filmed.character, BodyShape.of(0.2, {"thigh": 0.05, "torso": -0.05}))
    fit = fit_character(capture, capture.cameras, generic, FRAMES, height=tall)
    found, truth = (bone_lengths(one.skeleton) for one in (fit.character, filmed.character))
    assert float(stature(fit.character)) == pytest.approx(tall, rel=0.01)
    assert max(abs(float(found[name] / truth[name]) - 1) for name in ("thigh", "shank", "forearm")) < 0.04
    again = scaled(generic, fit.shape)
    np.testing.assert_allclose(again.vertices, fit.character.vertices, atol=5e-3)


@pytest.mark.slow
def test_the_body_is_made_of_keypoints_and_outlines_and_kept(folder, filmed, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # the body is not there yet
    said: list[str] = []
    steps: list[tuple] = []
    make = lambda: character_of(  # noqa: E731
        Capture.open(folder),
        height=float(stature(filmed.character)),
        say=said.append,
        progress=lambda *s: steps.append(s),
    )
    made = make()
    assert made.record is not None
    assert made.record["frames"] == list(FRAMES)
    assert made.record["keypoint_error_m"] < 0.01
    assert "made to measure at 4 frames" in said[0]
    found, truth = (bone_lengths(one.skeleton) for one in (made.character, filmed.character))
    assert max(abs(float(found[name] / truth[name]) - 1) for name in ("thigh", "shank", "upper_arm")) < 0.06
    assert {stage for stage, _, _ in steps} == {"body: poses", "body: shape", "body: masks"}
    count = len(steps)
    assert np.array_equal(make().character.vertices, made.character.vertices)
    assert len(steps) == count  # taken from the cache


def test_frames_beyond_those_wanted_tell_nothing_of_the_body(filmed, folder, monkeypatch):
    """Cameras that were lost there, or somebody else who walks in; selected frames of an earlier span do not count."""
    used: list[tuple[int, ...]] = []

    def fitted(capture, generic, frames, *told):
        used.append(frames)
        return MadeBody(generic)

    monkeypatch.setattr(_made_to_measure, "_fitted", fitted)
    capture = replace(Capture.open(folder), selected_frames=(0, 3))
    tall = float(stature(filmed.character))
    character_of(capture, height=tall, cache=False)
    character_of(capture, height=tall, within=(0, 3), cache=False)
    assert used == [(0, 1, 2, 3), (0, 1, 2)]


def with_silhouettes(capture: Capture, filmed: SyntheticCapture) -> Capture:
    """Write true outlines as a detector's."""
    (capture.keypoints_folder / SILHOUETTES).mkdir()
    for frame in FRAMES:
        for camera, name in enumerate(capture.camera_names):
            file = mask_file(capture.keypoints_folder / SILHOUETTES, name, frame)
            cv2.imwrite(str(file), 255 * filmed.masks[frame, camera].astype(np.uint8))
    return capture


def in_a_larger_world(capture: Capture) -> Capture:
    """Give a capture cameras whose world is 6 % too large."""
    larger = capture.cameras.cam_from_world.at[..., :3, 3].multiply(1.06)
    large = eqx.tree_at(lambda cameras: cameras.cam_from_world, capture.cameras, larger)
    write_cameras(large, capture.folder / "large", "colmap", capture.video_frames)
    return replace(capture, cameras_path=capture.folder / "large")


@pytest.mark.slow
def test_a_height_tells_how_much_too_large_the_world_of_the_cameras_is(folder, filmed, tmp_path):
    tall = float(stature(filmed.character))
    capture = in_a_larger_world(with_silhouettes(spoilt(folder, tmp_path), filmed))
    made = character_of(capture, height=tall, scale_cameras=True, cache=False)
    assert made.camera_scale == pytest.approx(1 / 1.06, rel=0.015)
    assert made.record["height_m"] == pytest.approx(tall, abs=1e-4)  # the outlines add to the surface
    assert float(stature(made.character)) == pytest.approx(tall, rel=0.01)
    found, truth = (bone_lengths(one.skeleton) for one in (made.character, filmed.character))
    assert max(abs(float(found[name] / truth[name]) - 1) for name in ("thigh", "shank", "upper_arm")) < 0.06


@pytest.mark.slow
def test_one_pose_from_eight_sides_tells_the_measure_and_the_scale(all_round, tmp_path):
    folder, tall = unnamed(all_round, tmp_path / "capture"), float(stature(all_round.character))
    text = (folder / "capture.toml").read_text()
    (folder / "capture.toml").write_text('masks = "masks"\n' + text)
    capture = in_a_larger_world(Capture.open(folder))
    made = character_of(capture, height=tall, scale_cameras=True, cache=False)
    assert made.record["masks"] == 8
    assert made.camera_scale == pytest.approx(1 / 1.06, rel=0.015)
    found, truth = (bone_lengths(one.skeleton) for one in (made.character, all_round.character))
    assert max(abs(float(found[name] / truth[name]) - 1) for name in ("thigh", "shank", "upper_arm")) < 0.06


@pytest.mark.slow
def test_one_pose_from_seven_sides_does_not(all_round, tmp_path):
    folder = unnamed(all_round, tmp_path / "capture")
    assert "is made to measure at frames 0" in no_actor(Capture.open(folder)).message
    text = (folder / "capture.toml").read_text()
    (folder / "capture.toml").write_text(text[: text.rindex("[[camera]]")])
    assert "only 1 frame has keypoints in two views, and 3 such" in no_actor(Capture.open(folder)).message


@pytest.mark.slow
def test_silhouettes_of_a_detector_give_outlines_of_all_frames_and_the_height_is_kept(folder, filmed, tmp_path):
    capture = with_silhouettes(spoilt(folder, tmp_path), filmed)
    tall = float(stature(filmed.character))
    made = character_of(capture, height=tall, cache=False)
    assert made.record["masks"] >= 7  # of eight; without silhouettes two frames are cut
    assert made.record["height_m"] == pytest.approx(tall, rel=0.01)
    found, truth = (bone_lengths(one.skeleton) for one in (made.character, filmed.character))
    assert max(abs(float(found[name] / truth[name]) - 1) for name in ("thigh", "shank", "upper_arm")) < 0.06


def test_one_camera_is_given_the_built_in_body_of_the_height_said(folder, tmp_path):
    text = (folder / "capture.toml").read_text()
    second = text[text.rindex("[[camera]]") :]
    capture = spoilt(folder, tmp_path, (second, ""))
    said: list[str] = []
    made = character_of(capture, height=1.6, say=said.append)
    assert np.array_equal(made.character.vertices, body(1.6).vertices)
    assert said == [
        "The built-in body, 1.60 m tall, stands for the person: one camera does not tell how long a person's limbs are."
    ]
    with pytest.raises(InputError, match=r"names no actor, .* one camera does not tell .*--height METRES"):
        character_of(capture)


@pytest.mark.parametrize(("frames", "words"), [(0, "no frame has keypoints"), (2, "only 2 frames have keypoints")])
def test_keypoints_at_too_few_frames_need_a_height(frames, words, folder, tmp_path):
    capture = spoilt(folder, tmp_path, frames=frames)
    with pytest.raises(InputError, match=f"{words} in two views, and 3 such frames are needed.*--height METRES"):
        character_of(capture)
    assert float(stature(character_of(capture, height=1.9).character)) == pytest.approx(1.9, abs=1e-3)
    assert no_actor(capture).severity == "warning"


def test_a_height_beside_an_actor_and_one_of_nobody_are_refused(folder, tmp_path):
    with pytest.raises(InputError, match=r"height is 18 m; 0.5 to 2.5 m was expected"):
        character_of(Capture.open(folder), height=18)
    with pytest.raises(InputError, match=r"a height is given \(1.8 m\).*leave one of them out"):
        character_of(Capture.open(folder), folder / "actor.glb", 1.8)


def test_check_says_that_a_body_is_made(folder, capsys):
    assert run(["check", str(folder), "--json"]) == 0
    found = [one for one in json.loads(capsys.readouterr().out) if one["where"] == "actor"]
    assert [one["severity"] for one in found] == ["note"]
    assert "the built-in body is made to measure at frames 0, 1, 2, 3" in found[0]["message"]
