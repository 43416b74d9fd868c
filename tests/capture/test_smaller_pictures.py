"""Large videos are worked on at a smaller size: whatever a capture gives is of the same camera, with fewer pixels."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from small_captures import MATRIX, PERSON, POSES, make_video, number_of, write_mask, write_model

from jaxmocap._results import InputError
from jaxmocap.camera import project, read_cameras
from jaxmocap.capture import Capture, check, content_hash
from jaxmocap.geometry import intersection_over_union

LARGE = (128, 96)
DISTORTION = "0.05 -0.01"


@pytest.fixture
def large(small: Path) -> Path:
    """The small capture, filmed with twice as many pixels through a lens that distorts."""
    for name, pose in POSES.items():
        make_video(small / f"{name}.mp4", size=LARGE)
        for frame in (0, 6):
            write_mask(small / "masks" / f"{name}_{frame:05d}.png", LARGE)
            local = PERSON @ pose[:3, :3].T + pose[:3, 3]
            file = small / "keypoints" / f"{name}_{frame:05d}_keypoints.json"
            ideal = local[:, :2] / local[:, 2:]
            square = (ideal**2).sum(1, keepdims=True)
            distorted = ideal * (1 + 0.05 * square - 0.01 * square**2)
            pixels = distorted * 2 * MATRIX[0, 0] + 2 * MATRIX[:2, 2]
            values = np.concatenate([pixels, np.full((25, 1), 0.9)], 1).ravel().tolist()
            file.write_text(f'{{"people": [{{"pose_keypoints_2d": {values}}}]}}')
    write_model(small / "cameras", POSES, 12, size=LARGE)
    (small / "cameras" / "cameras.txt").write_text(
        "".join(f"{i} RADIAL {LARGE[0]} {LARGE[1]} 120 64 48 {DISTORTION}\n" for i in (1, 2))
    )
    return small


def test_cameras_and_keypoints_agree_with_the_person_at_any_size(large: Path):
    for longest, sizes in ((None, LARGE), (64, (64, 48)), (100, (100, 76))):
        capture = Capture.open(large, longest_side=longest)
        assert capture.sizes == capture.cameras.sizes == (sizes, sizes)
        assert capture.recorded_sizes == (LARGE, LARGE)
        view = capture.cameras.at(6)
        pixels, _ = project(view.intrinsics, view.cam_from_world, jnp.asarray(PERSON, jnp.float32))
        for camera in range(2):
            found = capture.keypoints(camera, 6)
            assert found is not None
            np.testing.assert_allclose(found[:, :2], pixels[camera], atol=2e-3)
    focal = np.asarray(Capture.open(large, longest_side=100).cameras.intrinsics)[0, [0, 1], [0, 1]]
    np.testing.assert_allclose(focal, [120 * 100 / 128, 120 * 76 / 96], rtol=1e-6)


def test_images_and_masks_have_the_smaller_size(large: Path):
    capture, recorded = Capture.open(large, longest_side=64), Capture.open(large)
    for frame, images in capture.frames(5, 8):
        for camera, image in enumerate(images):
            assert image.shape == (48, 64, 3)
            assert number_of(image) == frame
            np.testing.assert_array_equal(image, capture.image(camera, frame))
    mean = recorded.image(0, 6).reshape(48, 2, 64, 2, 3).mean((1, 3))
    off = np.abs(mean - capture.image(0, 6))[8:-8, 8:-8]  # the lens is undone before and after the mean
    assert off.mean() < 3
    mask = capture.mask(1, 6)
    assert mask is not None
    assert mask.shape == (48, 64)
    assert abs(mask.sum() - 30 * 15 / 4) < 12
    back = capture.recorded_mask(1, mask)
    given = recorded.recorded_mask(1, recorded.mask(1, 6))  # pyright: ignore[reportArgumentType]
    assert back.shape == given.shape == LARGE[::-1]
    assert intersection_over_union(back, given) > 0.85


def test_the_size_comes_from_the_configuration_and_counts_as_content(large: Path):
    file = large / "capture.toml"
    assert Capture.open(large).longest_side == 960
    before = content_hash(Capture.open(large))
    assert content_hash(Capture.open(large, longest_side=500)) == before, "nothing is smaller"
    file.write_text("longest_side = 64\n" + file.read_text())
    capture = Capture.open(large)
    assert capture.sizes == ((64, 48), (64, 48))
    assert content_hash(capture) != before
    assert Capture.open(large, longest_side=128).sizes == (LARGE, LARGE)
    found = capture.as_recorded()
    assert found.sizes == found.cameras.sizes == (LARGE, LARGE)
    assert found.image(0, 0).shape == (96, 128, 3)
    told = [str(finding.message) for finding in check(large) if "longest_side" in finding.message]
    assert len(told) == 2
    assert "128x96 pixels are made 64x48" in told[0]
    assert Capture.open(large, with_cameras=False).sizes == (LARGE, LARGE), "what calibrates sees every pixel"


@pytest.mark.parametrize("value", ["0", "63", "961", '"small"', "1e3"])
def test_a_size_that_cannot_be_is_refused_with_a_sentence(large: Path, value: str):
    file = large / "capture.toml"
    file.write_text(f"longest_side = {value}\n" + file.read_text())
    with pytest.raises(InputError, match=r"capture\.toml: longest_side = .* cannot be used"):
        Capture.open(large)


@pytest.mark.parametrize("value", [0, -960, 63, 961])
def test_so_it_is_in_python(large: Path, value: int):
    with pytest.raises(InputError, match=f"longest_side is {value}; an even number of at least 64"):
        Capture.open(large, longest_side=value)


def test_cameras_of_another_size_see_as_much(large: Path):
    cameras = read_cameras(large / "cameras", ("cam0", "cam1"), 12, (LARGE, LARGE))
    smaller = cameras.resized(((64, 48), (32, 96)))
    assert smaller.sizes == ((64, 48), (32, 96))
    point = jnp.array([[0.2, 1.1, 0.1]])
    before = project(cameras.at(0).intrinsics, cameras.at(0).cam_from_world, point)[0]
    after = project(smaller.at(0).intrinsics, smaller.at(0).cam_from_world, point)[0]
    np.testing.assert_allclose(after[0], before[0] / 2, rtol=1e-5)
    np.testing.assert_allclose(after[1], before[1] * np.array([0.25, 1]), rtol=1e-5)
    assert cameras.resized(cameras.sizes) is cameras
