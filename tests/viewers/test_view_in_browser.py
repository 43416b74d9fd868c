"""The viewer's page in a browser: what it shows first, scrubbed, and through a camera that is clicked."""

import shutil
import time

import cv2
import numpy as np
import pytest

from jaxmocap.motion import Motion
from jaxmocap.synthetic import make_capture, write_capture
from jaxmocap.viewers import view

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytest.importorskip("viser", reason="viser, of the extra 'view', is not installed")
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")]
FRAMES, WINDOW = 40, {"width": 760, "height": 400}
SOFTWARE = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """A page on a synthetic capture whose left arm is lost in frame 20, and the viewer that serves it."""
    made = make_capture(FRAMES, (160, 90))
    folder = write_capture(made, tmp_path_factory.mktemp("world") / "capture")
    confidence = np.ones((FRAMES, len(made.character.skeleton.landmark_names)))
    arm = made.character.skeleton.bodies_of("l_arm")[list(made.character.skeleton.landmark_bodies)]
    confidence[20, arm] = 0
    motion = Motion.from_poses(
        made.character, made.poses, np.arange(FRAMES), made.timestamps,
        cameras=made.cameras, provenance={"capture": str(folder)}, confidence=confidence,
    )  # fmt: skip
    served = view(motion, port=18933)
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE)
        page = browser.new_page(viewport=WINDOW)
        page.goto(served.url)
        page.set_default_timeout(120_000)
        page.wait_for_selector("canvas")
        eventually(lambda: blue(page).any(), 240)
        yield page, served
        browser.close()
    served.stop()


def eventually(condition, seconds: float = 90.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it has not happened"
        time.sleep(0.2)


def picture(page) -> np.ndarray:
    box = page.locator("canvas").first.bounding_box()
    found = cv2.imdecode(np.frombuffer(page.screenshot(clip=box), np.uint8), cv2.IMREAD_COLOR)
    return found.astype(int)


def blue(page) -> np.ndarray:
    """Where the picture shows the body as found."""
    b, g, r = np.moveaxis(picture(page), -1, 0)
    return (b - r > 60) & (b > g)


def centre_on_canvas(page, served, camera: int) -> tuple[float, float]:
    """Where the middle of a camera's frustum is in the window."""
    (client,) = served._server.get_clients().values()
    box = page.locator("canvas").first.bounding_box()
    forward = client.camera.look_at - client.camera.position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, client.camera.up_direction)
    right /= np.linalg.norm(right)
    away = served.shown.frustum(camera, served.position)[1:].mean(axis=0) - client.camera.position
    focal = box["height"] / 2 / np.tan(client.camera.fov / 2)
    x, y = (focal * axis @ away / (forward @ away) for axis in (right, np.cross(forward, right)))
    return box["x"] + box["width"] / 2 + x, box["y"] + box["height"] / 2 + y


def test_the_first_view_frames_the_person_and_a_click_on_a_camera_looks_through_it(shown):
    page, served = shown
    time.sleep(2)
    body = blue(page)
    rows, columns = np.flatnonzero(body.any(axis=1)), np.flatnonzero(body.any(axis=0))
    assert rows[0] > 5
    assert rows[-1] < body.shape[0] - 5  # neither cut off below nor above,
    assert columns[0] > 5
    assert columns[-1] < body.shape[1] - 5
    assert rows[-1] - rows[0] > 0.15 * body.shape[0]  # and large enough to see
    places = [centre_on_canvas(page, served, camera) for camera in range(2)]
    for x, y in places:
        assert 0 < x < WINDOW["width"]
        assert 0 < y < WINDOW["height"]
    page.mouse.move(*places[1])
    page.mouse.click(*places[1])
    eventually(lambda: served._eye.value == served.shown.camera_names[1])
    (client,) = served._server.get_clients().values()
    there = served.shown.world_from_cam(1, served.position)[:3, 3]
    eventually(lambda: np.linalg.norm(client.camera.position - there) < 1e-3)
    assert served._cameras.screens[1].visible
    served._eye.value = "free"
    eventually(lambda: np.linalg.norm(client.camera.position - there) > 1)


def test_the_slider_goes_to_frames_and_a_lost_arm_turns_red(shown):
    page, served = shown
    slider = page.get_by_role("slider").first
    slider.focus()
    for _ in range(20):
        page.keyboard.press("ArrowRight")
    eventually(lambda: served.position == 20)
    assert set(served._body.parts) == {"ok", "doubtful", "lost"}

    def red() -> bool:
        b, g, r = np.moveaxis(picture(page), -1, 0)
        return bool(((r - b > 25) & (r - g > 25)).sum() > 10)

    eventually(red)
