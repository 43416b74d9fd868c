"""A generic character is made to the measure of a filmed one whose bones are known."""

import json
from collections.abc import Callable
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap._cli import run
from jaxmocap._results import InputError
from jaxmocap.camera import project
from jaxmocap.capture import KEYPOINT_NAMES, Capture
from jaxmocap.character import (
    GIRTHS,
    BodyShape,
    Character,
    body_transforms,
    bone_lengths,
    landmark_positions,
    scaled,
)
from jaxmocap.registration import CharacterFit, CharacterFitSettings, ShapePrior, fit_character
from jaxmocap.synthetic import SyntheticCapture, make_capture, write_capture

SIZE = (192, 108)
NOISE = 2.0 / 960  # of the width
FRAMES = (0, 1, 2, 3, 4)
VIEWS = (0, 2)  # of three cameras: 52 degrees apart
CHANGED = BodyShape.of(
    0.05, {"thigh": 0.06, "shank": -0.05, "upper_arm": -0.07, "forearm": 0.05, "torso": 0.05, "shoulders": 0.04}
)
LANDMARKS = {"pelvis": "mid_hip", "neck": "mid_shoulder"}
NO_OFFSETS = CharacterFitSettings(prior=ShapePrior(offset=0.002))


@pytest.fixture(scope="module")
def filmed() -> SyntheticCapture:
    """Five poses half a second apart; the images are small, for only their masks are looked at."""
    return make_capture(len(FRAMES), SIZE, 3, fps=2.0, selected_frames=FRAMES)


@pytest.fixture(scope="module")
def generic(filmed) -> Character:
    """What the fit starts from: bones 2 % shorter to 12 % longer than those of the person filmed."""
    return scaled(filmed.character, CHANGED)


@pytest.fixture(scope="module")
def capture_of(filmed, tmp_path_factory) -> Callable[..., Capture]:
    """Writes a capture in two views with noisy, partly wrong and partly missing keypoints."""

    def write(
        offsets: dict[str, np.ndarray] | None = None,
        generic: Character | None = None,
        masks: bool = False,
        filmed: SyntheticCapture = filmed,
    ) -> Capture:
        folder = write_capture(filmed, tmp_path_factory.mktemp("fit") / "capture")
        if generic is not None:
            generic.save_glb(folder / "actor.glb")
        toml = (folder / "capture.toml").read_text().split("[[camera]]")
        toml[0] = toml[0] if masks else toml[0].replace('masks = "masks"\n', "")
        (folder / "capture.toml").write_text("[[camera]]".join([toml[0], *(toml[1 + view] for view in VIEWS)]))
        random = np.random.default_rng(0)
        for frame in filmed.selected_frames:
            for view in VIEWS:
                points = detected(filmed, frame, view, offsets or {}, random)
                file = folder / "keypoints" / f"cam{view}_{frame:05d}_keypoints.json"
                file.write_text(json.dumps({"people": [{"pose_keypoints_2d": points.ravel().tolist()}]}))
        return Capture.open(folder)

    return write


def detected(filmed, frame, view, offsets, random) -> np.ndarray:
    """BODY_25 points with Gaussian noise; one is grossly wrong and one is missing in every view."""
    skeleton, pose, seen = filmed.character.skeleton, filmed.pose(frame), filmed.cameras.at(frame)
    places = np.array(landmark_positions(skeleton, pose))
    rotations = np.asarray(body_transforms(skeleton, pose))[:, :3, :3]
    for name, offset in offsets.items():
        for side, sign in (("l_", 1), ("r_", -1)):
            body = {"shoulder": f"{side}clavicle", "hip": "pelvis"}[name]
            turned = rotations[skeleton.body_names.index(body)] @ (offset * [sign, 1, 1])
            places[skeleton.landmark_names.index(side + name)] += turned
    at = dict(zip(skeleton.landmark_names, places, strict=True))
    at["mid_hip"], at["mid_shoulder"] = (0.5 * (at[f"l_{name}"] + at[f"r_{name}"]) for name in ("hip", "shoulder"))
    body = jnp.asarray([at[LANDMARKS.get(name, name)] for name in KEYPOINT_NAMES], jnp.float32)
    pixels, _ = project(seen.intrinsics[view], seen.cam_from_world[view], body)
    points = np.concatenate([np.asarray(pixels), random.uniform(0.5, 0.9, (25, 1))], axis=1)
    points[:, :2] += NOISE * filmed.size[0] * random.standard_normal((25, 2))
    wrong, missing = random.choice(25, 2, replace=False)
    points[wrong, :2] += random.choice([-1, 1], 2) * random.uniform(0.04, 0.08, 2) * filmed.size[0]
    points[missing, 2] = 0
    return points


@pytest.fixture(scope="module")
def capture(capture_of, generic) -> Capture:
    return capture_of(generic=generic)


@pytest.fixture(scope="module")
def fitted(capture, generic) -> CharacterFit:
    return fit_character(capture, capture.cameras, generic)


def excess(fit: CharacterFit, filmed: SyntheticCapture) -> dict[str, float]:
    """By which share each bone is longer than in truth."""
    found, truth = bone_lengths(fit.character.skeleton), bone_lengths(filmed.character.skeleton)
    return {name: float(found[name] / truth[name]) - 1 for name in truth}


@pytest.mark.slow
def test_lengths_are_found_to_3_percent_but_for_what_the_detector_may_see_elsewhere(fitted, filmed, generic):
    """Shoulder points may lie beside the shoulders, which trades their breadth against the upper arms."""
    errors = excess(fitted, filmed)
    shoulders = {name: errors.pop(name) for name in ("shoulders", "upper_arm")}
    assert max(map(abs, errors.values())) < 0.03
    assert max(map(abs, shoulders.values())) < 0.06
    assert fitted.num_masks == 0
    assert tuple(fitted.poses) == FRAMES
    assert fitted.keypoint_error < 0.01 < fitted.generic_error


@pytest.mark.slow
def test_with_a_detector_that_shows_the_joints_all_lengths_are_found_to_3_percent(capture, generic, filmed):
    fit = fit_character(capture, capture.cameras, generic, settings=NO_OFFSETS)
    assert max(map(abs, excess(fit, filmed).values())) < 0.03


@pytest.mark.slow
def test_points_beside_the_joints_are_found_to_be_beside_them(capture_of, generic, filmed):
    beside = {"hip": np.array([0.015, 0.03, 0.0])}
    capture = capture_of(beside)
    fit = fit_character(capture, capture.cameras, generic)
    stubborn = fit_character(capture, capture.cameras, generic, settings=NO_OFFSETS)
    assert fit.offsets["hip"][1] > 0.01
    assert abs(excess(fit, filmed)["thigh"]) < abs(excess(stubborn, filmed)["thigh"])


@pytest.mark.slow
def test_poses_are_those_of_the_person(fitted, filmed):
    skeleton = fitted.character.skeleton
    wanted = [skeleton.landmark_names.index(f"{side}_{name}") for side in "lr" for name in ("elbow", "knee", "ankle")]
    for frame, pose in fitted.poses.items():
        assert np.all((pose.angles >= skeleton.lower) & (pose.angles <= skeleton.upper))
        errors = np.linalg.norm(np.asarray(landmark_positions(skeleton, pose)) - filmed.joints[frame], axis=1)
        assert np.median(errors[wanted]) < 0.03


@pytest.mark.slow
def test_the_command_writes_the_same_character_and_says_what_it_did(capture, generic, tmp_path, capsys):
    """Of the actor as its file holds it: a millionth part in an axis is worth a millimetre between the shoulders."""
    fitted = fit_character(capture, capture.cameras, Character.load(capture.folder / "actor.glb"))
    out = tmp_path / "new" / "fitted.glb"
    arguments = ["fit-character", capture.folder, "--out", out, "--json"]
    assert run([str(argument) for argument in arguments]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["frames"], told["masks"]) == (list(FRAMES), 0)
    again = Character.load(out)
    assert float(again.misfit) == pytest.approx(CharacterFitSettings().misfit)
    np.testing.assert_allclose(again.vertices, fitted.character.vertices, atol=2e-4)
    for name, bone in bone_lengths(again.skeleton).items():
        assert told["bones_cm"][name]["fitted"] == pytest.approx(100 * float(bone), abs=0.01)
        assert told["bones_cm"][name]["generic"] == pytest.approx(
            100 * float(bone_lengths(generic.skeleton)[name]), abs=0.01
        )


@pytest.mark.slow
def test_more_than_half_of_a_change_in_girth_is_read_off_masks(capture_of):
    """Changes of 5 to 15 mm in radius, where a pixel is 9 mm; the prior keeps the rest."""
    changed = {"thigh": 0.15, "shank": -0.12, "torso": 0.12, "upper_arm": 0.15}
    large = make_capture(3, (480, 270), 3, fps=1.0, selected_frames=(0, 1, 2))
    capture = capture_of(masks=True, filmed=large)
    fit = fit_character(capture, capture.cameras, scaled(large.character, BodyShape.of(girths=changed)))
    found = dict(zip(GIRTHS, np.asarray(fit.shape.height + fit.shape.girths), strict=True))
    errors = {name: float(found[name] + change) for name, change in changed.items()}
    assert fit.num_masks == 3 * len(VIEWS)
    assert all(abs(errors[name]) < 0.5 * abs(change) for name, change in changed.items()), errors


@pytest.mark.parametrize(
    ("frames", "words"),
    [
        ((0, 1), "2 of the 2 frames to fit at .0, 1. have 3 or more keypoints in two views, .* needs 3 such frames"),
        ((0, 0, 0, 1), "2 of the 2 frames"),
        ((), "0 of the 0 frames"),
        ((0, 1, 9), "has no frame 9; its frames are 0 to 4"),
    ],
)
def test_too_few_frames_are_refused_in_a_sentence(frames, words, capture, generic):
    with pytest.raises(InputError, match=words):
        fit_character(capture, capture.cameras, generic, frames)


def test_frames_seen_by_one_camera_do_not_count(capture_of, generic):
    capture = capture_of()
    for frame in (1, 2, 3):
        (Path(capture.folder) / "keypoints" / f"cam2_{frame:05d}_keypoints.json").unlink()
    with pytest.raises(InputError, match="2 of the 5 frames"):
        fit_character(capture, capture.cameras, generic)


@pytest.mark.slow
def test_without_outlines_cameras_are_not_scaled_and_nothing_is_written(capture, tmp_path, capsys):
    before = sorted(Path(capture.folder).rglob("*"))
    out = tmp_path / "fitted.glb"
    arguments = ["fit-character", capture.folder, "--height", "1.7", "--scale-cameras", "--out", out]
    assert run([str(argument) for argument in arguments]) == 2
    assert "has no mask at frames 0, 1, 2, 3, 4, and only outlines tell" in capsys.readouterr().err
    assert not out.exists()
    assert sorted(Path(capture.folder).rglob("*")) == before
