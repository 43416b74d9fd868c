"""The report page in a browser without a network: scrubbed, played, and harmless."""

import shutil

import pytest
from test_report_page import FRAMES, HOSTILE, grey_videos, judged

from jaxmocap.viewers import report_page

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("browser") / "result"
    told = {"lost": [{"part": HOSTILE, "first": 1, "last": 1, "why": "x"}], "capture_name": HOSTILE}
    told["settings"] = {HOSTILE: HOSTILE}
    told["contacts"] = [{"landmark": "l_toe", "first": f, "last": f + 1} for f in (1, 6)]
    told["contacts"].append({"landmark": "r_heel", "first": 3, "last": 8})
    judged(provenance=told).save(folder)
    grey_videos(folder)
    path = report_page(folder)
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        opened = browser.new_context(offline=True, viewport={"width": 390, "height": 844}).new_page()
        opened.wrong = []
        opened.on("console", lambda message: opened.wrong.append(message.text))
        opened.on("pageerror", lambda error: opened.wrong.append(str(error)))
        opened.on("dialog", lambda dialog: opened.wrong.append(dialog.message))
        opened.on("request", lambda request: opened.wrong.append(request.url) if "http" in request.url[:5] else None)
        opened.goto(path.as_uri())
        yield opened
        browser.close()


def shade(page) -> int:
    """How bright the first view's picture is."""
    page.wait_for_timeout(50)
    return page.evaluate(
        """async () => {
            const image = document.querySelector('#stage img');
            await image.decode();
            const canvas = document.createElement('canvas');
            canvas.width = canvas.height = 1;
            canvas.getContext('2d').drawImage(image, 0, 0, 1, 1);
            return canvas.getContext('2d').getImageData(0, 0, 1, 1).data[1];
        }"""
    )


def test_keys_slider_and_curves_go_to_frames(page):
    assert page.inner_text("#where").startswith("frame 0,")
    assert abs(shade(page) - 40) < 4
    for key, frame in (("ArrowRight", 1), ("End", FRAMES - 1), ("ArrowLeft", FRAMES - 2), ("Home", 0), ("n", 4)):
        page.keyboard.press(key)
        assert page.inner_text("#where").startswith(f"frame {frame},")
        assert abs(shade(page) - (40 + 10 * frame)) < 4
    assert "doubtful" in page.inner_text("#where")
    page.locator("#slider").fill("7")
    assert page.inner_text("#where").startswith("frame 7,")
    page.locator("#findings button").first.click()
    assert page.inner_text("#where").startswith("frame 9,")
    page.locator("#jitter svg").scroll_into_view_if_needed()
    page.locator("#jitter svg").click(position={"x": 43, "y": 40})
    assert page.inner_text("#where").startswith("frame 0,")


def test_views_and_angles_are_chosen(page):
    assert page.locator("#stage figure:visible").count() == 2
    page.keyboard.press("2")
    assert page.locator("#stage figure:visible figcaption").inner_text() == "right"
    page.locator("#views button").first.click()
    assert page.locator("#stage figure:visible").count() == 2
    page.select_option("#dof", index=0)
    assert "lumbar_flex" in page.inner_text("#angle .legend")


def test_bars_below_the_foot_skate_are_the_contacts(page):
    """Left of 1 to 2 and 6 to 7, right of 3 to 8, each from half a frame before to half a frame after."""
    left, right = (page.locator(f'#skate rect[fill="var(--c{foot})"]') for foot in (0, 1))
    boxes = [one.bounding_box() for one in (*left.all(), *right.all())]
    frame = page.locator("#skate svg").bounding_box()
    step = (frame["width"] - 50) / (FRAMES - 1)
    begins = [(box["x"] - frame["x"] - 42) / step for box in boxes]
    assert begins == pytest.approx([0.5, 5.5, 2.5], abs=0.05)
    assert [box["width"] / step for box in boxes] == pytest.approx([2, 2, 6], abs=0.05)
    assert boxes[2]["y"] > boxes[0]["y"] + boxes[0]["height"]
    assert page.inner_text("#skate-bars").startswith("Bars: ")


def test_it_plays_in_the_time_of_the_video(page):
    page.keyboard.press("Home")
    page.keyboard.press(" ")
    for _ in range(100):
        if page.evaluate("here") >= 3:
            break
        page.wait_for_timeout(30)
    page.keyboard.press(" ")
    stopped = page.evaluate("here")
    assert stopped >= 3
    page.wait_for_timeout(200)
    assert page.evaluate("here") == stopped


def test_it_fits_a_phone_and_asks_nothing_of_anybody(page):
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert HOSTILE in page.inner_text("h1")
    assert HOSTILE in page.inner_text("#tables")
    assert page.wrong == []
