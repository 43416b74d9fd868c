"""What the page's program answers, what it writes, and whom it refuses."""

import json
import queue
import threading
import webbrowser

import cv2
import numpy as np
import pytest
from annotation_client import Client
from small_captures import MATRIX, PERSON, POSES, make_video, write_keypoints

from jaxmocap import InputError
from jaxmocap._cli import run
from jaxmocap.annotation import annotate
from jaxmocap.capture import Capture
from jaxmocap.detection import BODY_25, read_people

WRIST, NECK = BODY_25.points.index("r_wrist"), BODY_25.points.index("neck")
SHOULDERS = [BODY_25.points.index(name) for name in ("l_shoulder", "r_shoulder")]


def seen(camera: str) -> np.ndarray:
    pose = POSES[camera]
    pixels = (PERSON @ pose[:3, :3].T + pose[:3, 3]) @ MATRIX.T
    return pixels[:, :2] / pixels[:, 2:]


def test_the_page_shows_selected_frames_with_what_a_detector_found(capture, serve):
    page, client = serve(capture)
    state = client.get("state")
    assert page.frames == (0, 6)
    assert (state["frames"], state["num_frames"], state["calibrated"]) == ([0, 6], 12, True)
    assert [view["name"] for view in state["views"]] == ["cam0", "cam1"]
    found = client.get("frame?frame=6")
    np.testing.assert_allclose(found["views"][1]["points"], np.c_[seen("cam1"), np.full(25, 0.9)])
    status, content, headers = client.ask("GET", client.path)
    assert (status, b"<canvas" not in content) == (200, True)
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert b"http://" not in content.replace(b"http://www.w3.org/2000/svg", b"")
    status, picture, _ = client.ask("GET", f"{client.path}picture?camera=0&frame=5")
    assert (status, picture[:3]) == (200, b"\xff\xd8\xff")


def test_lines_in_the_other_view_pass_where_it_sees_the_point(capture, serve):
    _, client = serve(capture)
    lines = client.get("frame?frame=0")["lines"]
    assert len(lines) == 50
    asked = "line?camera=0&frame=0&x={}&y={}".format(*seen("cam0")[WRIST])
    (other,) = client.get(asked)
    (kept,) = [line["line"] for line in lines if line["from"] == 0 and line["point"] == WRIST]
    np.testing.assert_allclose(other["line"], kept, atol=0.02)
    start, end = np.array(kept)
    (dx, dy), (x, y) = (end - start) / np.linalg.norm(end - start), seen("cam1")[WRIST] - start
    assert abs(dx * y - dy * x) < 0.02


def test_a_point_that_is_set_is_on_disk_at_once_and_the_others_stay(capture, serve):
    file = capture / "keypoints" / "cam0_00006_keypoints.json"
    before = file.read_bytes()
    page, client = serve(capture)
    found = client.set(0, 6, WRIST, [12.25, 30.5])
    assert found["views"][0]["points"][WRIST] == [12.25, 30.5, 1.0]
    (person,) = read_people(file)
    np.testing.assert_allclose(person[WRIST], [12.25, 30.5, 1.0])
    others = np.arange(25) != WRIST
    np.testing.assert_allclose(person[others], np.c_[seen("cam0"), np.full(25, 0.9)][others], atol=0.006)
    np.testing.assert_allclose(Capture.open(capture).keypoints(0, 6), person)
    assert file.with_name(f"{file.name}.detected").read_bytes() == before
    assert page.written == (file,)
    client.set(0, 6, WRIST, [13, 30])
    assert file.with_name(f"{file.name}.detected").read_bytes() == before


def test_changes_are_undone_and_redone_across_views(capture, serve):
    _, client = serve(capture)
    client.set(0, 0, WRIST, [10, 20])
    client.set(1, 6, WRIST, None)
    assert client.get("state")["history"] == [2, 0]
    status, found = client.post("undo", {})
    assert (status, found["camera"], found["frame"], found["point"]) == (200, 1, 6, WRIST)
    assert found["views"][1]["points"][WRIST][2] == 0.9
    assert Capture.open(capture).keypoints(1, 6)[WRIST, 2] == 0.9
    client.post("undo", {})
    assert client.post("undo", {})[0] == 409
    assert client.post("redo", {})[1]["views"][0]["points"][WRIST] == [10, 20, 1]
    np.testing.assert_allclose(Capture.open(capture).keypoints(0, 0)[WRIST], [10, 20, 1])
    client.set(0, 0, WRIST, [11, 20])
    assert client.post("redo", {})[0] == 409


def test_the_neck_follows_the_shoulders_until_it_is_set(bare, serve):
    _, client = serve(bare)
    client.set(0, 0, SHOULDERS[0], [10, 20])
    assert client.get("frame?frame=0")["views"][0]["points"][NECK] == [0, 0, 0]
    client.set(0, 0, SHOULDERS[1], [20, 22])
    assert client.get("frame?frame=0")["views"][0]["points"][NECK] == [15, 21, 1]
    client.set(0, 0, SHOULDERS[1], [22, 22])
    assert client.get("frame?frame=0")["views"][0]["points"][NECK] == [16, 21, 1]
    client.set(0, 0, NECK, [14, 19])
    client.set(0, 0, SHOULDERS[1], [24, 22])
    assert client.get("frame?frame=0")["views"][0]["points"][NECK] == [14, 19, 1]


def test_a_capture_without_anything_gets_a_folder_which_it_names(bare, serve):
    page, client = serve(bare)
    assert page.frames == (0, 6)  # the first and the middle one
    before = (bare / "capture.toml").read_bytes()
    assert client.get("state")["calibrated"] is False
    assert client.get("frame?frame=3")["lines"] == []
    assert (bare / "capture.toml").read_bytes() == before
    client.set(1, 3, WRIST, [40, 30])
    assert (bare / "capture.toml").read_bytes().startswith(b"# filmed in May\r\n")
    opened = Capture.open(bare)
    assert opened.keypoints_folder == bare / "keypoints"
    np.testing.assert_allclose(opened.keypoints(1, 3)[WRIST], [40, 30, 1])
    client.post("undo", {})
    assert list((bare / "keypoints").iterdir()) == []


def test_files_of_another_layout_name_and_form_are_corrected_in_a_file_of_our_own(capture, serve):
    for file in (capture / "keypoints").iterdir():
        file.unlink()
    points = np.c_[np.arange(26), np.arange(26) + 10, np.full(26, 0.8)].ravel().tolist()
    video = [{"image_id": f"{frame}.jpg", "keypoints": points, "score": 2.0} for frame in range(12)]
    (capture / "keypoints" / "cam0.json").write_text(json.dumps(video))
    text = (capture / "capture.toml").read_text()
    (capture / "capture.toml").write_text(f'keypoint_layout = "halpe26"\n{text}')
    _, client = serve(capture)
    client.set(0, 6, WRIST, [40, 30])
    opened = Capture.open(capture)
    np.testing.assert_allclose(opened.keypoints(0, 6)[WRIST], [40, 30, 1])
    np.testing.assert_allclose(opened.keypoints(0, 6)[0], [0, 10, 0.8])
    np.testing.assert_allclose(opened.keypoints(0, 5)[WRIST], [10, 20, 0.8])


def test_of_several_people_another_one_is_taken(capture, serve):
    other = np.c_[seen("cam0") + 3, np.full(25, 0.5)]
    write_keypoints(capture / "keypoints" / "cam0_00000_keypoints.json", POSES["cam0"], other)
    _, client = serve(capture)
    found = client.get("frame?frame=0")
    assert [view["people"] for view in found["views"]] == [2, 1]
    status, found = client.post("person", {"camera": 0, "frame": 0, "person": 0})
    assert status == 200
    np.testing.assert_allclose(found["views"][0]["points"], other)
    assert len(Capture.open(capture).people(0, 0)) == 1
    assert client.post("person", {"camera": 0, "frame": 0, "person": 2})[0] == 400


def test_points_are_the_video_s_however_small_pictures_are_made(bare, serve):
    for name in POSES:
        (bare / f"{name}.mp4").unlink()
        make_video(bare / f"{name}.mp4", size=(128, 96))
    opened = Capture.open(bare, longest_side=64)
    _, client = serve(opened, frames=[2], cameras=["cam1"])
    state = client.get("state")
    assert (state["frames"], [view["shown"] for view in state["views"]]) == ([2], [False, True])
    assert state["views"][0]["size"] == [128, 96]
    picture = client.ask("GET", f"{client.path}picture?camera=1&frame=2")[1]
    assert cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR).shape == (96, 128, 3)
    client.set(1, 2, WRIST, [120, 90])
    np.testing.assert_allclose(Capture.open(bare, longest_side=64).keypoints(1, 2)[WRIST], [60, 45, 1])


# Who is refused, and what ----------------------------------------------------------------------------------------


def test_a_wrong_token_is_refused(capture, serve):
    _, client = serve(capture)
    for path in ("/", "/state", "/wrong/state", "/wrong/", "/%c3%a4/state", f"/x{client.path}state", "/../etc/passwd"):
        status, content, _ = client.ask("GET", path)
        assert status == 403, path
        assert client.path.strip("/").encode() not in content


def test_other_names_of_this_machine_and_other_pages_are_refused(capture, serve):
    _, client = serve(capture)
    assert client.ask("GET", client.path, Host="evil.example:80")[0] == 403
    assert client.ask("GET", client.path + "state", Origin="http://evil.example")[0] == 403
    body = json.dumps({"camera": 0, "frame": 0, "point": 4, "place": [1, 1]}).encode()
    assert client.ask("POST", client.path + "set", body, Content_Type="text/plain")[0] == 415
    assert client.ask("POST", client.path + "set", body, Content_Type="application/json", Origin="null")[0] == 403
    assert client.get("state")["history"] == [0, 0]


def test_no_file_is_served_by_its_name(capture, serve):
    _, client = serve(capture)
    for name in (
        "../capture.toml", "..%2fcapture.toml", "keypoints/cam0_00000_keypoints.json", "picture/../../state", "page.js",
    ):  # fmt: skip
        assert client.ask("GET", client.path + name)[0] == 404, name


def test_questions_for_what_is_not_there_are_refused(capture, serve):
    _, client = serve(capture)
    views = ("camera=2&frame=0", "camera=0&frame=12", "camera=../0&frame=0", "camera=0", "", "camera=0&frame=%00")
    lines = ("line?camera=0&frame=0&x=nan&y=3", "line?camera=0&frame=0&x=1", "line?camera=0&frame=0&x=1&y=49")
    for query in (*(f"picture?{view}" for view in views), "frame?frame=-1", "frame?frame=1e3", *lines):
        status, content, _ = client.ask("GET", client.path + query)
        assert status == 400, query
        assert json.loads(content)["error"]


GOOD = {"camera": 0, "frame": 0, "point": 4, "place": [1, 1]}


def test_malformed_changes_are_refused_and_change_nothing(capture, serve):
    file = capture / "keypoints" / "cam0_00000_keypoints.json"
    before = file.read_bytes()
    _, client = serve(capture)
    places = ([1], "1,1", [1, "1"], [float("nan"), 1], [65, 1], [-1, 1], [10**400, 1], {"x": 1}, [True, 1])
    wrong = [
        {"camera": 2},
        {"camera": True},
        {"camera": "0"},
        {"frame": 12},
        {"frame": 0.5},
        {"point": 25},
        {"point": -1},
    ]
    bodies = [json.dumps(GOOD | change).encode() for change in (*wrong, *({"place": place} for place in places))]
    bodies += [b"{", b"[]", b"\xff", b"[" * 3000, b"{}", json.dumps({"camera": 0, "frame": 0, "point": 4}).encode()]
    for body, expected in (*((body, 400) for body in bodies), (b"x" * 5000, 413)):
        status, content, _ = client.ask("POST", client.path + "set", body, Content_Type="application/json")
        assert status == expected, body[:80]
        assert json.loads(content)["error"]
    assert client.ask("PUT", client.path + "set", b"")[0] == 501
    assert file.read_bytes() == before


def test_what_cannot_be_read_or_written_is_said(capture, serve):
    (capture / "keypoints" / "cam0_00000_keypoints.json").write_text("{")
    _, client = serve(capture)
    status, content, _ = client.ask("GET", client.path + "frame?frame=0")
    assert (status, "is not JSON" in json.loads(content)["error"]) == (409, True)
    client.get("frame?frame=6")
    for file in (capture / "keypoints").iterdir():
        file.unlink()
    (capture / "keypoints").rmdir()
    (capture / "keypoints").write_text("")
    status, found = client.post("set", GOOD | {"frame": 6})
    assert (status, "cannot be written" in found["error"]) == (409, True)
    assert client.get("frame?frame=6")["views"][0]["points"][4][2] == 0.9


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"frames": [3, 12]}, "frame 12 is outside"),
        ({"cameras": ["cam7"]}, "no camera 'cam7'"),
        ({"port": 70000}, "port"),
    ],
)
def test_what_is_not_there_is_a_sentence(options, words, capture):
    with pytest.raises(InputError, match=words):
        annotate(capture, **options)


def test_where_a_port_is_taken_the_next_one_is_used(capture, serve):
    page, _ = serve(capture)
    port = int(page.url.split(":")[2].split("/")[0])
    second = annotate(capture, port=port)
    try:
        assert not second.url.startswith(f"http://127.0.0.1:{port}/")
    finally:
        second.stop()


def test_the_command_serves_until_finish_and_says_what_it_wrote(bare, monkeypatch, capsys):
    opened, codes = queue.Queue(), queue.Queue()
    monkeypatch.setattr(webbrowser, "open", opened.put)
    thread = threading.Thread(
        target=lambda: codes.put(run(["annotate", str(bare), "--frames", "2", "4:6", "--port", "0"]))
    )
    thread.start()
    client = Client(opened.get(timeout=60))
    assert client.get("state")["frames"] == [2, 4, 5]
    client.set(0, 2, WRIST, [5, 6])
    assert client.post("finish", {}) == (200, {"written": ["cam0_00002_keypoints.json"]})
    thread.join(timeout=20)
    assert codes.get(timeout=1) == 0
    assert f"1 file in {bare / 'keypoints'}." in capsys.readouterr().err


@pytest.mark.parametrize("frames", ["x", "4:4", "-1", "99"])
def test_the_command_refuses_frames_that_are_none(frames, capture, capsys):
    assert run(["annotate", str(capture), f"--frames={frames}", "--no-browser"]) == 2
    assert "frame" in capsys.readouterr().err
