import os
from pathlib import Path

import av
import cv2
import jax
import numpy as np
import pytest

from jaxmocap.appearance import background_distance, fit_background, fit_palette, label_image, psi_table, warp_grid
from jaxmocap.observation._features import (
    FeatureSettings,
    FrameFeatures,
    _consistent,
    frame_features,
    match_background,
    track_points,
)

DATA = Path(os.environ.get("JAXMOCAP_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))


@pytest.fixture(scope="module")
def texture():
    """Blurred noise, 300 x 400, with plenty of corners."""
    noise = np.random.default_rng(0).random((300, 400, 3)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 3)
    low, high = smooth.min(), smooth.max()
    return ((smooth - low) / (high - low) * 255).astype(np.uint8)


def square(shape, top, left, size):
    mask = np.zeros(shape[:2], bool)
    mask[top : top + size, left : left + size] = True
    return mask


@pytest.mark.parametrize("model", ["fundamental", "homography"])
def test_matches_that_magsac_asserts_on_are_checked_all_the_same(model):
    """Eight points that all moved alike, and one wrong match eight times: no fundamental matrix is the only one.
    OpenCV 5.0 ends in an assertion there."""
    random = np.random.default_rng(0)
    points = random.uniform(0, 300, (16, 2)).astype(np.float32)
    moved = points + np.float32([3, 1])
    points[:8], moved[:8] = points[0], random.uniform(0, 300, 2)
    kept, found = _consistent((points, moved), (300, 300), FeatureSettings(model=model, blocks=0))
    assert {tuple(point) for point in points[8:]} <= {tuple(point) for point in kept}
    np.testing.assert_allclose(found[-8:] - kept[-8:], np.broadcast_to([3, 1], (8, 2)), atol=1e-3)


def test_matches_of_a_shifted_image_are_the_shift(texture):
    shifted = np.roll(texture, (-4, 7), axis=(0, 1))
    points, moved = match_background(texture, None, shifted, None)
    assert len(points) > 100
    np.testing.assert_allclose(np.median(moved - points, axis=0), (7, -4), atol=0.05)


@pytest.mark.parametrize("scale", [0.5, 1.0])
def test_pixel_centres_are_at_one_half(texture, scale):
    halved = cv2.resize(texture, (200, 150), interpolation=cv2.INTER_AREA)
    large = cv2.resize(halved, (400, 300), interpolation=cv2.INTER_CUBIC)
    points, moved = match_background(large, None, halved, None, FeatureSettings(scales=(scale,), blocks=0))
    assert len(points) > 20
    np.testing.assert_allclose(np.median(moved - points / 2, axis=0), 0, atol=0.06)


@pytest.mark.parametrize("model", ["fundamental", "homography"])
def test_matches_avoid_masks_and_wrong_pairs(texture, model):
    rng = np.random.default_rng(1)
    other = np.roll(texture, (3, 5), axis=(0, 1))
    other[180:280, 250:350] = rng.integers(0, 255, (100, 100, 3))
    mask_from, mask_to = square(texture.shape, 40, 60, 80), square(texture.shape, 100, 200, 60)
    points, moved = match_background(texture, mask_from, other, mask_to, FeatureSettings(model=model))
    assert len(points) > 50
    assert not mask_from[points[:, 1].astype(int), points[:, 0].astype(int)].any()
    assert not mask_to[moved[:, 1].astype(int), moved[:, 0].astype(int)].any()
    assert (np.linalg.norm(moved - points - (5, 3), axis=1) < 2).mean() > 0.97


def test_features_of_a_selected_frame_are_computed_once(texture):
    features = frame_features(texture, None, 7)
    assert isinstance(features, FrameFeatures)
    assert features.at(0.5)[0] is features.at(0.5)[0]
    shifted = np.roll(texture, (0, 6), axis=(0, 1))
    for first, second in zip(
        match_background(features, None, shifted, None), match_background(texture, None, shifted, None), strict=True
    ):
        np.testing.assert_array_equal(first, second)


def test_an_image_without_texture_gives_no_matches():
    flat = np.full((100, 120, 3), 90, np.uint8)
    points, moved = match_background(flat, None, flat, None)
    assert points.shape == moved.shape == (0, 2)


def test_tracks_follow_the_image_and_drop_what_leaves_it(texture):
    points = np.random.default_rng(2).random((200, 2)) * (390, 290) + 5
    shifted = np.roll(texture, (2, -6), axis=(0, 1))
    hidden = square(texture.shape, 100, 100, 60)
    kept, moved = track_points(texture, shifted, (points, points), hidden)
    assert len(kept) > 120
    assert np.percentile(np.linalg.norm(moved - kept - (-6, 2), axis=1), 90) < 0.1
    assert not hidden[moved[:, 1].astype(int), moved[:, 0].astype(int)].any()
    assert (moved[:, 0] >= 0).all()


def test_few_direct_matches_are_completed_by_tracks(texture):
    unrelated = np.random.default_rng(3).integers(0, 255, texture.shape).astype(np.uint8)
    shifted = np.roll(texture, (1, 2), axis=(0, 1))
    ys, xs = np.mgrid[40:260:20, 40:360:20]
    earlier = np.stack([xs.ravel(), ys.ravel()], axis=1) + 0.5
    assert len(match_background(unrelated, None, shifted, None)[0]) < 50
    points, moved = match_background(unrelated, None, shifted, None, previous=(texture, (earlier + 30, earlier)))
    assert len(points) > 100
    np.testing.assert_allclose(np.median(moved - points, axis=0), (2 - 30, 1 - 30), atol=0.05)


class Plaza:
    """Single frames and masks of the rendered capture."""

    def __init__(self, folder):
        self.folder = folder

    def images(self, camera, frames):
        found = {}
        with av.open(str(self.folder / f"cam{camera}.mp4")) as video:
            for index, frame in enumerate(video.decode(video=0)):
                if index in frames:
                    found[index] = frame.to_ndarray(format="rgb24")
                if len(found) == len(frames):
                    break
        return [found[frame] for frame in frames]

    def mask(self, camera, frame):
        return cv2.imread(str(self.folder / "masks" / f"cam{camera}_{frame:05d}.png"), cv2.IMREAD_GRAYSCALE) > 127


@pytest.fixture(scope="module")
def plaza():
    folder = DATA / "plaza"
    if not folder.is_dir():
        pytest.skip(f"the capture {folder} is not there; set JAXMOCAP_DATA")
    return Plaza(folder)


@pytest.mark.parametrize("camera", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_the_warped_background_of_a_real_video_stays_near_and_the_person_far(plaza, camera):
    images = plaza.images(camera, [0, 10, 25, 50])
    mask, later_mask = plaza.mask(camera, 0), plaza.mask(camera, 50)
    model = fit_background(images[0], mask, key=jax.random.key(0))
    palette = fit_palette(np.concatenate([image.reshape(-1, 3)[::20] for image in images]))
    table = np.asarray(psi_table(model.colours, palette))
    features = frame_features(images[0], mask, 7)
    nothing = np.zeros((0, 2))
    unmoved = warp_grid(nothing, nothing, mask.shape)
    previous = None
    means = []
    for image in images:
        points, moved = match_background(features, None, image, None)
        previous = warp_grid(points, moved, image.shape[:2], previous=previous)
        means.append(background_distance(table, previous, label_image(palette, image)))
    away = np.ones(mask.shape, bool)
    away[:, 330:760] = False
    assert means[0][~mask].mean() < 0.08
    assert means[1][away].mean() < 0.1
    assert means[2][away].mean() < 0.1
    assert means[3][~later_mask].mean() < 0.1
    assert means[0][mask].mean() > 0.8
    assert means[3][later_mask].mean() > 0.75
    unwarped = background_distance(table, unmoved, label_image(palette, images[3]))
    assert unwarped[~later_mask].mean() > 1.5 * means[3][~later_mask].mean()
