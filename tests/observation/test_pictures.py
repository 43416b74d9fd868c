"""Edges, flow and samples of pictures with known answers."""

import cv2
import numpy as np
import pytest

from jaxmocap.observation import (
    dense_flow,
    flow_agrees,
    image_edges,
    mask_edges,
    sample_picture,
)


def step_picture(column=30, shape=(60, 80)):
    image = np.full((*shape, 3), 60, np.uint8)
    image[:, column:] = 200
    return image


def test_canny_finds_a_step_and_sobel_says_which_way():
    mask, gradient = image_edges(step_picture())
    assert mask.dtype == bool
    assert mask.any(1)[2:-2].all()
    columns = np.nonzero(mask)[1]
    assert set(columns) <= {29, 30}
    np.testing.assert_allclose(gradient[mask], [[1.0, 0.0]] * mask.sum(), atol=1e-5)
    down = image_edges(np.ascontiguousarray(step_picture()[::, ::-1].transpose(1, 0, 2)))
    np.testing.assert_allclose(down[1][down[0]], [[0.0, -1.0]] * down[0].sum(), atol=1e-5)


def test_flat_pictures_have_no_edges_and_no_direction():
    mask, gradient = image_edges(np.full((40, 40, 3), 128, np.uint8))
    assert not mask.any()
    np.testing.assert_array_equal(gradient, 0)


def test_faint_edges_are_left_out():
    faint = step_picture()
    faint[:, 30:] = 66
    assert not image_edges(faint)[0].any()


@pytest.fixture
def disc():
    y, x = np.mgrid[:100, :120]
    return np.hypot(x - 60, y - 50) < 30


def test_mask_edges_are_its_outermost_pixels_pointing_inward(disc):
    outline, gradient = mask_edges(disc)
    assert np.all(disc[outline])
    inner = cv2.erode(disc.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    np.testing.assert_array_equal(outline, disc & ~inner)
    y, x = np.nonzero(outline)
    inward = np.stack([60 - x, 50 - y], 1) / np.hypot(60 - x, 50 - y)[:, None]
    assert ((gradient[outline] * inward).sum(1) > 0.97).all()


def test_a_mask_cut_by_the_picture_has_no_edge_there():
    mask = np.zeros((40, 60), bool)
    mask[:20, 30:] = True
    outline, _ = mask_edges(mask)
    assert not outline[5:15, 59].any()
    assert not outline[0, 35:55].any()
    assert outline[5:15, 30].all()
    assert outline[19, 35:55].all()


@pytest.fixture(scope="module")
def texture():
    noise = np.random.default_rng(0).random((160, 200)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return ((smooth - smooth.min()) / np.ptp(smooth) * 255).astype(np.uint8)


def moved(picture, dx, dy):
    """The picture whose content has moved by (dx, dy) pixels."""
    return cv2.warpAffine(
        picture,
        np.float32([[1, 0, dx], [0, 1, dy]]),
        picture.shape[::-1],
        flags=cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REFLECT,
    )


@pytest.mark.parametrize("shift", [(0.0, 0.0), (3.0, -2.0), (-4.5, 5.25)])
@pytest.mark.parametrize("preset", ["medium", "fast"])
def test_flow_of_a_moved_texture_is_the_motion(texture, shift, preset):
    flow = dense_flow(texture, moved(texture, *shift), preset)
    assert flow.shape == (160, 200, 2)
    error = np.linalg.norm(flow[12:-12, 12:-12] - shift, axis=-1)
    assert error.mean() < 0.25
    assert np.quantile(error, 0.99) < 0.7


def test_flow_takes_views_of_larger_pictures(texture):
    part = texture[10:150, 20:180]
    flow = dense_flow(part, moved(texture, 2, 1)[10:150, 20:180])
    np.testing.assert_allclose(np.median(flow, (0, 1)), [2, 1], atol=0.05)


def test_flow_that_returns_agrees_and_flow_that_does_not_does_not():
    forward = np.zeros((30, 40, 2), np.float32)
    forward[..., 0] = 4.0
    backward = -forward
    agrees = flow_agrees(forward, backward)
    assert agrees[:, :-4].all()
    assert not agrees[:, -3:].any()  # these leave the picture
    backward[10:20, 10:20] = 4.0
    agrees = flow_agrees(forward, backward)
    assert not agrees[10:20, 6:16].any()
    assert agrees[:9, :-4].all()


def test_slack_and_relative_tolerance_of_the_flow_check():
    forward = np.full((10, 10, 2), 0.0, np.float32)
    backward = np.full((10, 10, 2), [0.6, 0.0], np.float32)  # 0.36 < 0.5
    assert flow_agrees(forward, backward).all()
    assert not flow_agrees(forward, backward, slack=0.3).any()


def test_occluded_pixels_do_not_agree(texture):
    """A square slides over the texture; what it comes to cover cannot return."""
    square = np.random.default_rng(1).integers(0, 255, (40, 40)).astype(np.uint8)
    square = cv2.GaussianBlur(square, (0, 0), 1.5)
    first, second = texture.copy(), texture.copy()
    first[60:100, 60:100], second[60:100, 68:108] = square, square
    agrees = flow_agrees(dense_flow(first, second), dense_flow(second, first))
    assert agrees[20:50].mean() > 0.95
    assert agrees[70:90, 70:90].mean() > 0.9
    assert agrees[65:95, 102:106].mean() < 0.4


def test_first_pixel_centre_is_at_one_half():
    picture = np.array([[0, 10, 20], [40, 50, 60]], np.float32)
    columns, rows = np.array([[0.5, 1.0, 2.5, 1.5]]), np.array([[0.5, 0.5, 1.5, 1.0]])
    np.testing.assert_allclose(sample_picture(picture, columns, rows), [[0, 5, 60, 30]], atol=1e-4)


def test_samples_beyond_the_picture_repeat_its_border():
    picture = np.array([[0, 10], [40, 50]], np.float32)
    found = sample_picture(picture, np.array([[-9.0, 9.0]]), np.array([[0.5, 1.5]]))
    np.testing.assert_allclose(found, [[0, 50]], atol=1e-4)
