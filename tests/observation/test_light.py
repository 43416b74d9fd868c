"""Light that changes while the camera moves: known gains, and pictures that must stay as they are."""

import cv2
import numpy as np
import pytest

from jaxmocap.observation import FrameImages, LightMeter, relit


@pytest.fixture(scope="module")
def scene():
    """A textured wall, wider than what a picture shows."""
    rng = np.random.default_rng(0)
    coarse, fine = rng.uniform(60, 160, (30, 60, 3)), rng.normal(0, 12, (300, 600, 3))
    return cv2.resize(coarse, (600, 300), interpolation=cv2.INTER_CUBIC) + cv2.GaussianBlur(fine, (0, 0), 1.0)


def filmed(scene, frame, gain=1.0):
    """Frame of a pan of two pixels per frame, with a grey person of another motion and sensor noise."""
    picture = scene[50:230, 2 * frame : 2 * frame + 320].copy()
    picture[60:160, 140 - 3 * frame % 40 : 180 - 3 * frame % 40] = 90
    noise = np.random.default_rng(frame).normal(0, 2, picture.shape)
    return np.clip(picture * gain + noise, 0, 255).astype(np.uint8)


def measured(pictures):
    meter = LightMeter.begin(pictures[0])
    lights = [meter.light]
    for picture in pictures[1:]:
        meter = meter.at(picture)
        lights.append(meter.light)
    return np.stack(lights), meter


def test_a_gain_per_channel_is_measured_while_the_camera_pans(scene):
    rise = np.linspace(0, 1, 100)[:, None] * np.log([1.3, 1.15, 0.8])
    lights, meter = measured([filmed(scene, frame, np.exp(rise[frame])) for frame in range(100)])
    np.testing.assert_allclose(lights, rise, atol=0.02)
    np.testing.assert_allclose(meter.factors(), [1.3, 1.15, 0.8], rtol=0.03)


def test_steady_light_leaves_every_picture_as_it_is(scene):
    pictures = [filmed(scene, frame) for frame in range(0, 140, 2)]
    lights, meter = measured(pictures)
    assert np.abs(lights).max() < 0.02
    factors = meter.factors()
    assert (factors == 1).all()
    assert relit(pictures[:1], factors[None])[0] is pictures[0]


def test_a_picture_is_brought_back(scene):
    plain, bright = filmed(scene, 3), filmed(scene, 3, 1.25)
    shown = FrameImages(3, 0.1, [bright]).in_light(np.full((1, 3), 1.25))
    assert np.abs(shown.images[0].astype(float) - plain).mean() < 2
    assert (shown.light == 1.25).all()


def test_small_changes_are_left_and_large_ones_taken_out_wholly(scene):
    small = _meter_with(scene, 0.04)
    half = _meter_with(scene, 0.075)
    large = _meter_with(scene, -0.2)
    np.testing.assert_array_equal(small.factors(), 1.0)
    np.testing.assert_allclose(half.factors(), np.exp(0.05))
    np.testing.assert_allclose(large.factors(), np.exp(-0.2))


def test_a_picture_that_shows_nothing_of_the_earlier_ones_keeps_the_light(scene):
    meter = LightMeter.begin(filmed(scene, 0))
    other = np.random.default_rng(5).integers(0, 255, (180, 320, 3)).astype(np.uint8)
    assert (meter.at(np.zeros_like(other)).light == 0).all()


def _meter_with(scene, light):
    return LightMeter.begin(filmed(scene, 0))._replace(light=np.full(3, light))
