"""Where the rectangle lies: margins, common size, growth, and a person out of view."""

import numpy as np
import pytest

from jaxmocap._results import InputError
from jaxmocap.observation import Rectangle, place_rectangle, projected_box
from jaxmocap.observation._rectangle import SIDES

SIZES = ((1280, 720), (1280, 720))
STILL = np.zeros(2)


def holds(rectangle, boxes, margin, sizes=SIZES):
    """Whether every widened box, cut to its image, lies inside (the corner is rounded down to 4 pixels)."""
    inside = []
    for box, (row, column), (width, height) in zip(boxes, rectangle.origins, sizes, strict=True):
        left, top = np.maximum(box[:2] - margin, 0)
        right, bottom = np.minimum(box[2:] + margin, [width, height])
        inside.append(
            column <= left and row <= top and column + rectangle.width >= right and row + rectangle.height >= bottom
        )
    return all(inside)


@pytest.mark.parametrize(
    ("box", "flow", "margin"),
    [
        ((600, 300, 700, 400), 0.0, 20.0),
        ((300, 100, 700, 500), 0.0, 40.0),  # a tenth of its size
        ((600, 300, 700, 400), 30.0, 45.0),  # one and a half times the flow
        ((300, 100, 700, 500), 10.0, 40.0),
    ],
)
def test_margin_is_the_largest_of_three(box, flow, margin):
    boxes = np.array([box, box], float)
    placed = place_rectangle(boxes, np.full(2, flow), SIZES)
    tight = (box[2] - box[0] + 2 * margin) * (box[3] - box[1] + 2 * margin)
    assert placed.area == pytest.approx(tight)
    assert holds(placed, boxes, margin)
    np.testing.assert_array_equal(boxes, [box, box])  # the caller's boxes are left alone


def test_boxes_of_different_size_share_one_rectangle_size():
    boxes = np.array([[100, 100, 200, 500], [500, 200, 900, 300]], float)
    placed = place_rectangle(boxes, STILL, SIZES)
    assert holds(placed, boxes, 40.0)
    assert placed.width >= 480
    assert placed.height >= 480
    assert placed.area == pytest.approx(((100 + 80) * 480 + 480 * (100 + 80)) / 2)
    assert np.all(placed.origins % 4 == 0)
    assert placed.width in SIDES
    assert placed.height in SIDES


def test_margins_beyond_the_image_are_cut():
    boxes = np.array([[5, 300, 105, 400], [1200, 600, 1275, 715]], float)
    placed = place_rectangle(boxes, STILL, SIZES)
    assert holds(placed, boxes, 20.0)
    assert np.all(placed.origins >= 0)
    assert np.all(placed.origins + [placed.height, placed.width] <= [720, 1280])
    assert placed.area == pytest.approx((125 * 140 + 100 * 140) / 2)


def test_the_size_never_shrinks_and_grows_when_it_must():
    large = np.array([[300, 50, 820, 570]] * 2, float)
    small = np.array([[600, 300, 650, 350]] * 2, float)
    first = place_rectangle(large, STILL, SIZES)
    kept = place_rectangle(small, STILL, SIZES, first)
    assert (kept.width, kept.height) == (first.width, first.height)
    assert kept.area < first.area
    assert holds(kept, small, 20.0)
    alone = place_rectangle(small, STILL, SIZES)
    assert alone.width < first.width
    grown = place_rectangle(large, STILL, SIZES, alone)
    assert (grown.width, grown.height) == (first.width, first.height)
    assert holds(grown, large, 52.0)


def test_a_new_size_has_slack_so_that_small_growth_keeps_it():
    box = np.array([[600, 300, 800, 500]] * 2, float)
    first = place_rectangle(box, STILL, SIZES)
    wider = place_rectangle(box + [-5, -5, 5, 5], STILL, SIZES, first)
    assert (wider.width, wider.height) == (first.width, first.height)


def test_the_size_stays_inside_the_smallest_image_in_multiples_of_four():
    sizes = ((1280, 720), (642, 362))
    placed = place_rectangle(np.array([[0, 0, 1280, 720], [0, 0, 642, 362]], float), STILL, sizes)
    assert (placed.width, placed.height) == (640, 360)
    assert np.all(placed.origins % 4 == 0)


def test_a_small_picture_has_the_square_of_its_shorter_side():
    sizes = ((480, 270), (480, 270))
    far, near, wide = ([100, 50, 200, 240], [100, 10, 250, 265], [50, 10, 330, 265])
    for box, size in ((far, (268, 268)), (near, (268, 268)), (wide, (268, 480))):
        assert place_rectangle(np.array([box, box], float), STILL, sizes).size == size


@pytest.mark.parametrize("box", [(-300, 10, -20, 400), (1300, 10, 1500, 400), (10, -400, 200, -5), (10, 730, 200, 900)])
def test_a_person_out_of_view_is_refused_and_the_camera_named(box):
    boxes = np.array([[300, 100, 700, 500], box], float)
    with pytest.raises(InputError, match="left the image of camera 'right'; check the cameras"):
        place_rectangle(boxes, STILL, SIZES, names=("left", "right"))
    with pytest.raises(InputError, match="camera '1'"):
        place_rectangle(boxes, STILL, SIZES)


def test_a_person_half_in_view_is_kept():
    boxes = np.array([[-200, 100, 100, 500], [1200, 600, 1500, 900]], float)
    placed = place_rectangle(boxes, STILL, SIZES)
    assert holds(placed, boxes, 30.0)


def test_crop_is_the_part_of_each_view():
    image = np.arange(30 * 40).reshape(30, 40)
    rectangle = Rectangle(np.array([[4, 8], [0, 12]]), 16, 20, 320.0)
    np.testing.assert_array_equal(rectangle.crop(image, 0), image[4:20, 8:28])
    np.testing.assert_array_equal(rectangle.crop(image, 1), image[0:16, 12:32])


def test_box_of_known_points():
    intrinsics = np.array([[100.0, 0, 50], [0, 100, 40], [0, 0, 1]])
    camera = np.eye(4)
    camera[2, 3] = 2.0
    points = np.array([[-1.0, 0, 0], [1, 1, 0], [0, -1, 2], [0, 0, -5]])  # the last lies behind
    np.testing.assert_allclose(projected_box(points, intrinsics, camera), [0, 15, 100, 90])
    assert projected_box(points[3:], intrinsics, camera) is None
