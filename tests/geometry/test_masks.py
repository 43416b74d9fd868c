import numpy as np
import pytest

from jaxmocap.geometry import intersection_over_union


def test_two_squares_that_share_eight_pixels_of_twenty_four():
    a, b = np.zeros((2, 10, 10), bool)
    a[:4, :4], b[2:6, :4] = True, True
    assert intersection_over_union(a, b) == pytest.approx(8 / 24)
    assert intersection_over_union(a, a) == 1
    assert intersection_over_union(a, ~a) == 0


def test_each_view_has_its_own_and_what_is_empty_is_as_asked():
    a = np.zeros((3, 4, 4), bool)
    b = a.copy()
    a[1], b[1, :2], b[2] = True, True, True
    np.testing.assert_array_equal(intersection_over_union(a, b), [np.nan, 0.5, 0])
    np.testing.assert_array_equal(intersection_over_union(a, b, empty=1.0), [1, 0.5, 0])
