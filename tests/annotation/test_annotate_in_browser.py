"""The page in a browser: clicked, dragged, used with keys alone, and without a word of complaint."""

import shutil

import numpy as np
import pytest

from jaxmocap.annotation import annotate
from jaxmocap.capture import Capture
from jaxmocap.detection import BODY_25

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")
NOSE, SHOULDER, ELBOW = (BODY_25.points.index(name) for name in ("nose", "r_shoulder", "r_elbow"))


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield started
        started.close()


@pytest.fixture
def opened(browser, request):
    """Opens a capture's page; nothing must be said on the console, and nobody else be asked."""
    stops, wrong = [], []

    def start(capture):
        served = annotate(capture, port=0)
        page = browser.new_context(viewport={"width": 1200, "height": 700}).new_page()
        stops.extend([page.context.close, served.stop])
        page.on("console", lambda message: wrong.append(message.text))
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on(
            "request", lambda asked: None if asked.url.startswith((served.url, "data:")) else wrong.append(asked.url)
        )
        page.goto(served.url)
        until(page, "views.length > 0 && views.every((view) => view.image)")
        return page

    yield start
    for stop in stops:
        stop()
    assert wrong == []


def until(page, condition: str) -> None:
    for _ in range(500):
        if page.evaluate(condition):
            return
        page.wait_for_timeout(20)
    raise AssertionError(f"never came true: {condition}")


def at(page, view: int, place) -> tuple[float, float]:
    """Where on the screen a pixel of a view's video is."""
    x, y = page.evaluate(f"views[{view}].toScreen({[float(value) for value in place[:2]]})")
    box = page.locator("canvas").nth(view).bounding_box()
    return box["x"] + x, box["y"] + y


def saved(page) -> None:
    page.evaluate("line")
    assert page.is_hidden("#alert")


def test_points_are_clicked_one_after_the_other_dragged_and_undone(bare, opened):
    page = opened(bare)
    assert page.inner_text("#wanted") == "cam0: click the nose"
    page.mouse.click(*at(page, 0, [30, 10]))
    assert page.inner_text("#wanted") == "cam0: click the right shoulder"
    page.mouse.click(*at(page, 0, [25, 20]))
    assert page.inner_text("#wanted") == "cam0: click the right elbow"
    saved(page)
    points = Capture.open(bare).keypoints(0, 0)
    np.testing.assert_allclose(points[[NOSE, SHOULDER]], [[30, 10, 1], [25, 20, 1]], atol=0.1)
    assert points[ELBOW, 2] == 0
    page.mouse.move(*at(page, 0, [25, 20]))
    page.mouse.down()
    page.mouse.move(*at(page, 0, [22, 24]), steps=4)
    page.mouse.up()
    saved(page)
    np.testing.assert_allclose(Capture.open(bare).keypoints(0, 0)[SHOULDER], [22, 24, 1], atol=0.1)
    page.click("#undo")
    until(page, f"Math.abs(views[0].points[{SHOULDER}][0] - 25) < 0.1")
    page.keyboard.press("Control+Shift+Z")
    until(page, f"Math.abs(views[0].points[{SHOULDER}][0] - 22) < 0.1")
    page.locator("canvas").nth(1).click(position={"x": 50, "y": 50})
    assert "cam1" in page.inner_text("#status")


def test_a_detector_s_point_is_corrected_with_the_line_of_the_other_view(capture, opened):
    page = opened(capture)
    before = Capture.open(capture).keypoints(1, 0)
    page.click("#points button:has-text('right elbow')")
    line = f"views[1].lines.filter((one) => one.point === {ELBOW}).map((one) => one.line)[0]"
    first = page.evaluate(line)
    start = page.evaluate(f"views[0].points[{ELBOW}]")
    page.mouse.move(*at(page, 0, start))
    page.mouse.down()
    page.mouse.move(*at(page, 0, [start[0], start[1] + 6]), steps=4)
    until(page, f"Math.abs({line}[0][1] - {first[0][1]}) > 3")  # it follows before the button is up
    page.mouse.up()
    saved(page)
    found = Capture.open(capture)
    np.testing.assert_allclose(found.keypoints(0, 0)[ELBOW], [start[0], start[1] + 6, 1], atol=0.2)
    np.testing.assert_array_equal(found.keypoints(1, 0), before)


def test_keys_alone_are_enough(bare, opened):
    page = opened(bare)
    page.locator("canvas").first.focus()
    for key in ("Shift+ArrowUp", "ArrowLeft", "ArrowLeft", "Enter"):
        page.keyboard.press(key)
    saved(page)
    np.testing.assert_allclose(Capture.open(bare).keypoints(0, 0)[NOSE], [30, 14, 1])
    assert page.inner_text("#wanted") == "cam0: click the right shoulder"
    page.keyboard.press("p")
    for key in ("ArrowDown", "ArrowDown", "Shift+ArrowRight"):
        page.keyboard.press(key)
    until(page, "nudged === null")
    saved(page)
    np.testing.assert_allclose(Capture.open(bare).keypoints(0, 0)[NOSE], [40, 16, 1])
    assert page.evaluate("state.history[0]") == 2  # a run of nudges is one change
    page.keyboard.press("ArrowDown")  # and taken away before it is told
    page.keyboard.press("Delete")
    saved(page)
    assert Capture.open(bare).keypoints(0, 0) is None
    page.keyboard.press("Control+z")
    until(page, f"views[0].points[{NOSE}][2] === 1")
    page.keyboard.press("ArrowUp")
    page.keyboard.press("PageDown")  # at once: what was moved is told of the frame in which it was
    until(page, "frame === 6 && views.every((view) => view.frame === 6)")
    saved(page)
    np.testing.assert_allclose(Capture.open(bare).keypoints(0, 0)[NOSE], [40, 16, 1])
    assert Capture.open(bare).keypoints(0, 6) is None
    assert page.inner_text("#wanted") == "cam0: click the nose"
    page.keyboard.press("Tab")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.tagName") != "BODY"


def test_zoom_keeps_the_place_and_any_frame_is_reached(bare, opened):
    page = opened(bare)
    place = [round(value) for value in at(page, 0, [20, 15])]
    box = page.locator("canvas").first.bounding_box()
    there = page.evaluate(f"views[0].toVideo([{place[0] - box['x']}, {place[1] - box['y']}])")
    page.mouse.move(*place)
    for _ in range(8):
        page.mouse.wheel(0, -100)
    until(page, "views[0].zoom > 4")
    np.testing.assert_allclose(at(page, 0, there), place, atol=0.01)
    page.mouse.click(*place)
    saved(page)
    np.testing.assert_allclose(Capture.open(bare).keypoints(0, 0)[NOSE], [*there, 1], atol=0.02)
    page.keyboard.press("0")
    assert page.evaluate("views[0].zoom") == 1
    page.fill("#number", "9")
    page.click("#other button")
    until(page, "frame === 9 && views.every((view) => view.frame === 9 && view.image)")
    page.click("#chosen button:has-text('cam0')")
    assert page.locator("figure:visible").count() == 1
    page.click("#finish")
    until(page, "document.getElementById('status').textContent.startsWith('Saved: cam0_00000')")
