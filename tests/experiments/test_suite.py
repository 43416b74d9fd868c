"""The synthetic suite shows what it says it shows."""

import numpy as np
import pytest

from jaxmocap.camera import project
from jaxmocap.capture import Capture, Detections, content_hash
from jaxmocap.experiments import STORIES, CaptureSpec, film, story
from jaxmocap.synthetic import Outfit, SyntheticCapture, body_25, make_actor, make_capture
from jaxmocap.synthetic._clothes import _PLAIN_SHIRT

SMALL = {"num_frames": 2, "size": (192, 108), "selected_frames": [0, 1], "sensor_noise": 0.0}


def small(name: str, **changes) -> SyntheticCapture:
    return make_capture(**{**SMALL, **STORIES[name][1], **changes})


def body_colours(style: str) -> tuple[np.ndarray, np.ndarray]:
    """Of the upper arms and of the torso."""
    points = np.asarray(make_actor().vertices, np.float32)
    colours = Outfit.make(0, style).colours(points)
    arms = (np.abs(points[:, 0]) > 0.25) & (np.abs(points[:, 0]) < 0.35) & (points[:, 1] > 1.2)
    torso = (np.abs(points[:, 0]) < 0.12) & (points[:, 1] > 1.1) & (points[:, 1] < 1.35)
    assert arms.sum() > 30
    assert torso.sum() > 30
    return colours[arms], colours[torso]


def test_arms_are_of_the_torso_s_colour_in_the_first_story_only():
    (arms, torso), (others, pattern) = body_colours("uniform"), body_colours("patterned")
    assert np.abs(arms.mean(0) - torso.mean(0)).max() < 0.02
    assert pattern.std(0).max() > 5 * torso.std(0).max()
    assert others.std(0).max() > 5 * arms.std(0).max()


def test_plain_sleeves_have_one_colour_along_the_arm_beside_a_patterned_torso():
    arms, torso = body_colours("plain sleeves")
    assert np.abs(arms.mean(0) - _PLAIN_SHIRT).max() < 0.02
    assert torso.std(0).max() > 5 * arms.std(0).max()


def test_forearms_pass_before_the_torso_in_the_first_story():
    crossing = make_capture(8, (96, 54), fps=15.0, **STORIES["arms-like-torso"][1])
    names = crossing.joint_names
    wrists, chest = (
        crossing.joints[:, [names.index(n) for n in which]] for which in (("l_wrist", "r_wrist"), ("thorax",))
    )
    ahead = wrists[..., 2] - chest[..., 2]
    aside = np.abs(wrists[..., 0] - chest[..., 0])
    assert (ahead > 0.1).mean() > 0.9
    assert aside.min() < 0.1


def test_the_background_of_the_third_story_looks_like_the_arms():
    def distance(name: str) -> float:
        shown = small(name)
        arms = np.sqrt(body_colours("patterned")[0].astype(float) ** 2).mean(0)
        around = shown.images[0, 0][~shown.masks[0, 0]][: 192 * 70].reshape(-1, 3) / 255.0
        hue, wanted = around / around.sum(1, keepdims=True), np.array([0.42, 0.32, 0.26])  # of skin
        assert arms.shape == (3,)
        return float(np.median(np.abs(hue - wanted).sum(1)))

    assert distance("background-like-arms") < 0.5 * distance("fast-motion")


def test_the_two_cameras_of_the_narrow_story_are_six_degrees_apart():
    shown = small("narrow-angle", camera_shake=0.0)
    centres = np.asarray(shown.cameras.centres())[:, 0] * [1, 0, 1]
    one, two = centres / np.linalg.norm(centres, axis=1, keepdims=True)
    assert np.degrees(np.arccos(one @ two)) == pytest.approx(6.0, abs=0.7)


def test_the_light_changes_in_its_story():
    shown = small("changing-light", num_frames=4)
    brightness = shown.images.astype(float).mean((1, 2, 3, 4))
    assert brightness[1] / brightness[3] > 1.15


def test_keypoints_of_any_frame_lie_near_the_joints():
    shown = small("fast-motion")
    points = body_25(shown, [1], noise=0.0)[0]
    view = shown.cameras.at(1)
    pixels, _ = project(view.intrinsics, view.cam_from_world, shown.joints[1, [shown.joint_names.index("l_wrist")]])
    np.testing.assert_allclose(points[:, 7, :2], np.asarray(pixels)[:, 0], atol=0.01)
    assert not np.allclose(body_25(shown, [1], noise=2.5)[0], points)


def test_a_capture_is_filmed_once_and_again_to_the_same_bytes(tmp_path):
    spec = CaptureSpec("square", {**SMALL, "size": (96, 54)})
    first = film(spec, tmp_path / "a")
    written = (first / "cam0.mp4").stat().st_mtime_ns
    assert film(spec, tmp_path / "a") == first
    assert (first / "cam0.mp4").stat().st_mtime_ns == written
    second = film(spec, tmp_path / "b")
    assert content_hash(Capture.open(first)) == content_hash(Capture.open(second))
    other = film(spec.varied(seed=1), tmp_path / "a")
    assert content_hash(Capture.open(other)) != content_hash(Capture.open(first))
    capture = Capture.open(first)
    detections = Detections.open(capture, first / "keypoints_all")
    assert detections.people(1, 1)[0].shape == (25, 3)


def test_stories_have_names_of_their_own_and_frames_to_select():
    for quick in (True, False):
        keys = {story(name, quick=quick).key for name in STORIES}
        assert len(keys) == len(STORIES)
        arguments = story("fast-motion", quick=quick).arguments
        assert len(arguments["selected_frames"]) == 5
        assert max(arguments["selected_frames"]) == arguments["num_frames"] - 1
