"""Phones held upright beside phones held lying: what is tracked lies one way, and all that belongs to it agrees."""

import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from small_captures import PERSON, POSES, make_video, number_of, write_mask

from jaxmocap.camera import project
from jaxmocap.capture import Capture
from jaxmocap.capture._picture_steps import turns

UPRIGHT = (48, 64)
LENS = "0.05 -0.01"


@pytest.fixture
def mixed(small: Path) -> Path:
    """The small capture, whose second phone was held upright, with a lens that distorts."""
    make_video(small / "cam1.mp4", size=UPRIGHT)
    models = (small / "cameras" / "cameras.txt").read_text().splitlines()
    models = [line for line in models if not line.startswith("2 ")] + [f"2 RADIAL 48 64 60 24 32 {LENS}"]
    (small / "cameras" / "cameras.txt").write_text("\n".join(models) + "\n")
    pose = POSES["cam1"]
    local = PERSON @ pose[:3, :3].T + pose[:3, 3]
    ideal = local[:, :2] / local[:, 2:]
    square = (ideal**2).sum(1, keepdims=True)
    pixels = 60 * ideal * (1 + 0.05 * square - 0.01 * square**2) + [24, 32]
    person = {"pose_keypoints_2d": np.concatenate([pixels, np.full((25, 1), 0.9)], 1).ravel().tolist()}
    for frame in (0, 6):
        write_mask(small / "masks" / f"cam1_{frame:05d}.png", UPRIGHT)
        (small / "keypoints" / f"cam1_{frame:05d}_keypoints.json").write_text(json.dumps({"people": [person]}))
    return small


def test_pictures_are_turned_where_more_of_them_is_in_common_then():
    lying, upright = (960, 540), (540, 960)
    assert turns([lying, upright]) == (False, True)
    assert turns([upright, lying]) == (True, False)
    assert turns([lying, (1280, 720), upright]) == (False, False, True)
    assert turns([lying, lying]) == turns([upright, upright]) == (False, False)
    assert turns([lying, (400, 540)]) == (False, False)  # 400 x 540 in common as they are, 540 x 400 turned
    assert turns([(640, 640), upright]) == (False, False)


def test_a_capture_held_one_way_is_itself(small: Path):
    capture = Capture.open(small)
    assert capture.one_way_up() is capture


def test_cameras_keypoints_pictures_and_masks_are_turned_together(mixed: Path):
    filmed = Capture.open(mixed)
    seen = filmed.image(1, 6)  # before the copy is made, which must not share it
    capture = filmed.one_way_up()
    assert filmed.sizes == ((64, 48), UPRIGHT)
    assert capture.sizes == capture.cameras.sizes == ((64, 48), (64, 48))
    assert capture.one_way_up() is capture
    view = capture.cameras.at(6)
    pixels, depths = project(view.intrinsics, view.cam_from_world, jnp.asarray(PERSON, jnp.float32))
    for camera in range(2):
        found = capture.keypoints(camera, 6)
        assert found is not None
        np.testing.assert_allclose(found[:, :2], pixels[camera], atol=2e-3)
    assert float(depths.min()) > 3
    np.testing.assert_allclose(capture.cameras.centres(), filmed.cameras.centres(), atol=1e-5)
    back = capture.cameras_as_filmed(capture.cameras)
    assert back.sizes == filmed.sizes
    np.testing.assert_array_equal(back.cam_from_world, filmed.cameras.cam_from_world)
    np.testing.assert_array_equal(back.distortion, filmed.cameras.distortion)
    np.testing.assert_allclose(back.intrinsics, filmed.cameras.intrinsics, atol=1e-4)
    assert filmed.cameras_as_filmed(filmed.cameras) is filmed.cameras

    np.testing.assert_array_equal(capture.image(1, 6), np.rot90(seen))
    for frame, images in capture.frames(5, 7):
        assert [image.shape for image in images] == [(48, 64, 3)] * 2
        assert number_of(capture.as_filmed(1, images[1])) == number_of(capture.as_filmed(0, images[0])) == frame
    mask, given = capture.mask(1, 6), filmed.mask(1, 6)
    assert mask is not None
    assert given is not None
    np.testing.assert_array_equal(mask, np.rot90(given))
    np.testing.assert_array_equal(capture.recorded_mask(1, mask), filmed.recorded_mask(1, given))


def test_masks_that_were_found_are_turned_too(mixed: Path):
    mask = np.zeros(UPRIGHT[::-1], bool)
    mask[:20, :5] = True
    filmed = Capture.open(mixed).with_masks({3: [None, mask]})
    turned = filmed.one_way_up().mask(1, 3)
    assert turned is not None
    np.testing.assert_array_equal(turned, np.rot90(mask))
    assert filmed.one_way_up().mask(0, 3) is None
