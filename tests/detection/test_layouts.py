"""Layouts of keypoints as tables."""

import numpy as np
import pytest

from jaxmocap.detection import BODY_25, LAYOUTS, to_body_25

COUNTS = {"body25": 25, "coco17": 17, "coco133": 133, "halpe26": 26, "halpe136": 136, "blazepose33": 33}


def place(name):
    """A point of its own for every name."""
    return np.array([len(name) + ord(name[-1]) / 7, 10.0 * ord(name[0]) + sum(map(ord, name)) / 3])


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_point_of_a_layout_arrives_where_body_25_has_it(name):
    layout = LAYOUTS[name]
    assert len(layout.points) == len(set(layout.points)) == COUNTS[name]
    points = np.stack([[*place(point), 0.5 + number / 1000] for number, point in enumerate(layout.points)])
    found = to_body_25(points, layout)
    middles = {"neck": ("l_shoulder", "r_shoulder"), "mid_hip": ("l_hip", "r_hip")}
    for row, point in zip(found, BODY_25.points, strict=True):
        if point in layout.points:
            assert (row == points[layout.points.index(point)]).all(), point
        elif point in middles:
            left, right = (points[layout.points.index(part)] for part in middles[point])
            np.testing.assert_allclose(row, [*(left[:2] + right[:2]) / 2, min(left[2], right[2])])
        else:
            assert (row == 0).all(), point
    lacking = {point for point, row in zip(BODY_25.points, found, strict=True) if row[2] == 0}
    toes = {"l_small_toe", "r_small_toe"}
    feet = {"l_big_toe", "r_big_toe", "l_heel", "r_heel", *toes}
    assert lacking == {"coco17": feet, "blazepose33": toes}.get(name, set())


def test_a_middle_of_which_one_side_was_not_found_was_not_found():
    layout = LAYOUTS["coco17"]
    points = np.full((17, 3), 0.8)
    points[layout.points.index("l_hip")] = 0.0
    found = to_body_25(points, layout)
    assert (found[BODY_25.points.index("mid_hip")] == 0).all()
    assert found[BODY_25.points.index("neck"), 2] == 0.8


@pytest.mark.parametrize(
    ("name", "number", "point"),
    [
        ("coco17", 16, "r_ankle"), ("coco133", 17, "l_big_toe"), ("coco133", 22, "r_heel"), ("coco133", 91, "l_hand_0"),
        ("halpe26", 18, "neck"), ("halpe26", 19, "mid_hip"), ("halpe26", 21, "r_big_toe"), ("halpe26", 24, "l_heel"),
        ("halpe136", 26, "face_0"), ("halpe136", 94, "l_hand_0"), ("halpe136", 115, "r_hand_0"),
        ("blazepose33", 11, "l_shoulder"), ("blazepose33", 24, "r_hip"), ("blazepose33", 29, "l_heel"),
        ("blazepose33", 32, "r_big_toe"), ("body25", 8, "mid_hip"), ("body25", 21, "l_heel"),
    ],
)  # fmt: skip
def test_points_have_the_numbers_of_their_publications(name, number, point):
    assert LAYOUTS[name].points[number] == point
