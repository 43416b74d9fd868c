"""The report page: what it says of results whose verdict is known, what it holds, and that nothing in it acts."""

import base64
import json
import os
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import cv2
import jax.numpy as jnp
import numpy as np
import pytest
from box_figure import box_character, box_motion

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras
from jaxmocap.capture import Capture
from jaxmocap.character import angles_at_rest
from jaxmocap.motion import Motion
from jaxmocap.synthetic import make_capture, write_capture
from jaxmocap.verdict._doubts import APART
from jaxmocap.viewers import report_page, write_overlay_video
from jaxmocap.viewers._report_findings import findings, frame_verdicts, headline
from jaxmocap.viewers._report_pictures import report_pictures

CHARACTER = box_character()
FRAMES = 12
HOSTILE = "</script><img src=x onerror=alert(1)> & <b>"


def cameras(names=("left", "right")) -> Cameras:
    facing = np.diag([1.0, -1, -1, 1])
    facing[:3, 3] = 0, 1, 4
    return Cameras(
        names=names,
        sizes=((120, 80),) * len(names),
        intrinsics=jnp.tile(jnp.asarray([[100.0, 0, 60], [0, 100, 40], [0, 0, 1]]), (len(names), 1, 1)),
        distortion=jnp.zeros((len(names), 5)),
        cam_from_world=jnp.asarray(np.broadcast_to(facing, (len(names), FRAMES, 4, 4))),
    )


def judged(**fields) -> Motion:
    """Frames 4 and 5 doubtful, 6 passed over, 9 lost; the left arm lost in 1 and 2."""
    status = np.full(FRAMES, "ok", dtype="<U8")
    status[[4, 5, 6]], status[9] = "doubtful", "lost"
    energy = np.linspace(0.1, 0.3, FRAMES)
    energy[6] = np.nan
    confidence = np.full((FRAMES, len(CHARACTER.skeleton.landmark_names)), 0.9)
    confidence[6], confidence[9] = 0, 0.1
    lost = [
        {"part": "left arm", "first": 1, "last": 2, "why": "no view shows it"},
        {"part": "body", "first": 9, "last": 9, "why": "the body's pixels look like the background"},
    ]
    fields = {"provenance": {"lost": lost, "capture_name": "yard"}, "cameras": cameras(), **fields}
    return box_motion(CHARACTER, FRAMES, confidence=confidence, status=status, energy={"model_view": energy}, **fields)


def grey_videos(folder: Path, names=("left", "right"), frames: int = FRAMES) -> None:
    """Overlay videos whose frame t is grey, 10 t + 40 in the first view and 10 t + 60 in the second."""
    for view, name in enumerate(names):
        images = [np.full((80, 120, 3), 10 * t + 40 + 20 * view, np.uint8) for t in range(frames)]
        write_overlay_video(folder / f"overlay_{name}.mp4", [(t / 30, image) for t, image in enumerate(images)])


@pytest.fixture
def result(tmp_path) -> Path:
    folder = judged().save(tmp_path / "result")
    grey_videos(folder)
    return folder


def data_of(page: Path) -> dict:
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', page.read_text())[1])


def picture(uri: str) -> np.ndarray:
    kind, text = uri.split(",", 1)
    assert kind == "data:image/webp;base64"
    return cv2.imdecode(np.frombuffer(base64.b64decode(text), np.uint8), cv2.IMREAD_COLOR)


class Parsed(HTMLParser):
    """Tags with their attributes, and all text outside scripts and styles."""

    def __init__(self, text: str):
        super().__init__()
        self.tags, self.text, self._inside = [], "", []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self._inside.append(tag)

    def handle_endtag(self, tag):
        while self._inside and self._inside.pop() != tag:
            pass

    def handle_data(self, data):
        if not {"script", "style"} & set(self._inside):
            self.text += data


# The verdict ------------------------------------------------------------------------------------------------------


def test_the_verdict_counts_frames_that_are_ok_and_have_every_limb():
    motion = judged()
    assert headline(motion) == (
        "6 of 12 frames can be trusted. In 2 more the left arm is lost, and the rest can be used."
    )
    assert (
        frame_verdicts(motion) == ["ok"] * 4 + ["doubtful"] * 2 + ["passed over"] + ["ok"] * 2 + ["lost"] + ["ok"] * 2
    )
    assert headline(motion[10:]) == "All 2 frames can be trusted."
    assert headline(motion[10:11]) == "The only frame can be trusted."


def test_findings_name_frames_and_reasons_the_worst_first():
    told = [(one["kind"], one["text"], one["frames"]) for one in findings(judged())]
    assert [kind for kind, _, _ in told] == ["lost", "passed over", "doubtful", "lost", "note"]
    assert told[0] == ("lost", "Lost: frame 9: the body's pixels look like the background.", [9])
    assert told[1][1].startswith("Passed over: frame 6: a flash")
    assert told[2][1].startswith("Doubtful: frames 4-5: ")
    assert told[2][2] == [4]
    assert told[3] == ("lost", "The left arm is lost in frames 1-2: no view shows it.", [1])
    assert 9 in told[4][2]
    assert 6 not in told[4][2]  # it was not looked at, so there is nothing to see


def test_the_page_names_the_entry_of_the_guide_beside_a_finding(tmp_path):
    """Words of an older version that the guide no longer explains stand alone."""
    limb = {"part": "left arm", "first": 1, "last": 2, "why": "no view shows it"}
    body = {"part": "body", "first": 9, "last": 9, "why": "the moon is full"}
    doubt = {"first": 4, "last": 5, "why": APART}
    motion = judged(provenance={"lost": [limb, body], "doubts": [doubt]})
    text = Parsed(report_page(motion.save(tmp_path / "result")).read_text()).text
    assert f"frames 4-5: {APART}. In the guide: The views disagree." in text
    assert "frames 1-2: no view shows it. In the guide: No view shows a limb." in text
    assert text.count("In the guide: ") == 3
    assert "In the guide: A flash lights the picture." in text


def test_doubtful_frames_are_told_with_their_reasons():
    doubts = [{"first": f, "last": f + 1, "why": why} for f, why in ((1, "views apart"), (4, "beside"), (7, "beside"))]
    told = [one for one in findings(judged(provenance={"doubts": doubts})) if one["kind"] == "doubtful"]
    assert [(one["text"], one["frames"]) for one in told] == [
        ("Doubtful: frames 1-2: views apart.", [1]),
        ("Doubtful: frames 4-5, 7-8: beside.", [4, 7]),
    ]


def test_a_camera_that_the_others_contradict_is_named():
    odd = [{"camera": "left", "first": f, "last": f + 1, "why": "it stood still"} for f in (1, 7)]
    told = [one for one in findings(judged(provenance={"outlier_cameras": odd})) if "left" in one["text"]]
    assert [(one["kind"], one["text"], one["frames"]) for one in told] == [
        ("doubtful", "Camera left is left out of the verdict in frames 1-2, 7-8: it stood still.", [1, 7])
    ]


def test_a_part_of_a_motion_tells_of_its_own_frames():
    told = judged().provenance | {"doubts": [{"first": 4, "last": 9, "why": "dark"}]}
    told["outlier_cameras"] = [{"camera": "left", "first": 8, "last": 9, "why": "off"}]
    found = findings(judged(provenance=told)[:6])
    assert {frame for finding in found for frame in finding["frames"]} <= set(range(6))
    assert [finding["text"] for finding in found if "Doubtful" in finding["text"]] == ["Doubtful: frames 4-5: dark."]
    assert not any("Camera left" in finding["text"] for finding in found)


def test_where_nothing_can_be_trusted_the_verdict_says_so():
    assert headline(judged()[[4, 5, 6, 9]]) == "No frame can be trusted."
    only = "No frame can be trusted as a whole. In 2 the left arm is lost, and the rest can be used."
    assert headline(judged()[1:3]) == only


@pytest.mark.parametrize(
    ("parts", "usable"),
    [
        (("left arm", "right arm"), "limbs are lost (left arm, right arm), and legs and trunk can be used"),
        (("left leg", "right leg"), "limbs are lost (left leg, right leg), and arms and trunk can be used"),
        (("left arm", "right leg"), "limbs are lost (left arm, right leg), and trunk and head can be used"),
    ],
)
def test_the_verdict_says_what_can_be_used_where_limbs_are_lost(parts, usable):
    """What is lost in frames that are doubtful anyway, as 4 and 5 are, is not counted."""
    spans = [{"part": part, "first": 1 + k, "last": 2, "why": "no view shows it"} for k, part in enumerate(parts)]
    spans.append({"part": "left arm", "first": 4, "last": 5, "why": "dark"})
    assert headline(judged(provenance={"lost": spans})[:6]) == f"2 of 6 frames can be trusted. In 2 more {usable}."


def test_spans_of_a_limb_are_told_together_and_not_without_end():
    spans = [{"part": "left leg", "first": f, "last": f, "why": "it leaves its way"} for f in (1, 3, 8)]
    found = [one for one in findings(judged(provenance={"lost": spans})) if "leg" in one["text"]]
    assert [one["text"] for one in found] == ["The left leg is lost in frames 1, 3, 8: it leaves its way."]
    assert found[0]["frames"] == [1, 3, 8]
    status = np.where(np.arange(60) % 2, "ok", "doubtful")
    told = findings(box_motion(CHARACTER, 60, status=status, energy={"model_view": np.ones(60)}))[0]
    assert told["text"].startswith("Doubtful: frames 0, 2, 4, 6, 8, 10, 12, 14 and 22 places more: ")
    assert told["frames"] == [0, 2, 4, 6, 8, 10, 12, 14]


def test_a_clip_that_nobody_tracked_has_no_verdict():
    clip = box_motion(CHARACTER, 3)
    assert "not tracked" in headline(clip)
    assert findings(clip) == []


def test_a_doubtful_mask_is_named_by_the_frame_of_the_first_video():
    fit = {"iou": [0.9, None], "keypoint_rms_m": 0.02, "masks": {"left": {"source": "found", "confidence": 0.3}}}
    told = {"lost": [], "registration": {"2": fit}, "selected_frames": {"frames": [7], "source": "chosen"}}
    found = [one for one in findings(judged(provenance=told)) if "mask" in one["text"]]
    assert found[0]["frames"] == [7]
    assert "left at selected frame 7 was found with confidence 0.30" in found[0]["text"]


# The file ---------------------------------------------------------------------------------------------------------


def test_the_page_stands_alone(result):
    page = report_page(result)
    assert page == result / "report.html"
    text = page.read_text()
    parsed = Parsed(text)
    assert not [attrs for _, attrs in parsed.tags if "src" in attrs or "href" in attrs]
    assert "link" not in dict(parsed.tags)
    assert set(re.findall(r"https?://[^\s\"'<]+", text)) == {"http://www.w3.org/2000/svg"}
    policy = next(attrs["content"] for tag, attrs in parsed.tags if "http-equiv" in attrs)
    assert policy.startswith("default-src 'none'; img-src data:;")
    assert ("meta", {"name": "viewport", "content": "width=device-width, initial-scale=1"}) in parsed.tags
    assert "6 of 12 frames can be trusted" in parsed.text


def test_names_with_html_in_them_are_text(tmp_path):
    told = {"lost": [{"part": HOSTILE, "first": 1, "last": 1, "why": HOSTILE}], "capture_name": HOSTILE}
    told["versions"] = told["settings"] = {HOSTILE: HOSTILE}
    motion = judged(provenance=told, cameras=cameras((HOSTILE.replace("/", ""), "b")))
    page = report_page(motion.save(tmp_path / "result"))
    parsed = Parsed(page.read_text())
    assert parsed.text.count(HOSTILE) == 5  # the title twice, a part twice, its reason
    assert "img" not in [tag for tag, _ in parsed.tags]
    assert [tag for tag, _ in parsed.tags].count("script") == 2
    data = data_of(page)
    assert [HOSTILE, HOSTILE] in [row for table in data["tables"] for row in table["rows"]]


def test_the_numbers_are_those_of_the_motion(result):
    motion, data = Motion.load(result), data_of(report_page(result))
    skeleton = motion.character.skeleton
    dof = skeleton.dof_names.index("l_elbow_flex") - 6
    angle = data["angles"][dof]
    rest = angles_at_rest(skeleton)[dof]
    assert angle["name"] == "l_elbow_flex"
    np.testing.assert_allclose(angle["values"], np.degrees(motion.angles[:, dof] + rest), atol=0.06)
    assert (angle["lower"], angle["upper"]) == (-5, 150)  # the table in docs/conventions.md
    assert angle["at_limit"] == np.sum(np.degrees(motion.angles[:, dof] + rest) < -4)
    assert data["energy"]["model_view"][6] is None
    assert data["energy"]["model_view"][11] == 0.3
    assert data["frames"] == list(range(FRAMES))
    assert data["confidence"]["values"][0][9] == 0.1
    assert data["jitter"]["values"][0] is None
    assert len(data["skate"]["left"]) == FRAMES
    assert data["uncertainty"] is None


def test_the_uncertainty_is_in_centimetres_along_one_axis(tmp_path):
    motion = judged()
    covariance = np.zeros((*motion.joints.shape, 3)) + np.diag([1e-4, 4e-4, 4e-4])
    covariance[3, motion.joint_names.index("l_wrist")] *= 4
    data = data_of(report_page(replace(motion, covariance=covariance).save(tmp_path / "result")))
    expected = np.full(FRAMES, np.sqrt(3))
    np.testing.assert_allclose(data["uncertainty"]["r_wrist"], expected, atol=0.006)
    expected[3] *= 2
    np.testing.assert_allclose(data["uncertainty"]["l_wrist"], expected, atol=0.006)
    assert next(iter(data["uncertainty"])) == "median over joints"


def test_the_page_knows_in_which_frames_a_foot_stands(tmp_path):
    contacts = [{"landmark": "l_heel", "first": 2, "last": 4}, {"landmark": "l_toe", "first": 4, "last": 6}]
    contacts.append({"landmark": "r_toe", "first": 9, "last": 11})
    motion = judged(provenance={"lost": [], "contacts": contacts})
    contact = data_of(report_page(motion.save(tmp_path / "result")))["skate"]["contact"]
    assert contact == {"left": [0, 0, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0], "right": [0] * 9 + [1] * 3}
    none = data_of(report_page(judged(provenance={"lost": [], "contacts": []}).save(tmp_path / "none")))
    assert none["skate"]["contact"] == {"left": [0] * 12, "right": [0] * 12}
    assert data_of(report_page(judged().save(tmp_path / "not looked for")))["skate"]["contact"] is None


def test_timings_are_summed_by_stage_and_by_frame(result):
    verdicts = [{"frame": frame, "seconds": {"flow": 0.5, "search": 1.0 + frame}} for frame in range(FRAMES)]
    (result / "report.json").write_text(json.dumps({"verdicts": verdicts}))
    timings = data_of(report_page(result))["timings"]
    assert timings["stages"] == [["search", 78.0], ["flow", 6.0]]
    assert timings["frames"] == [1.5 + frame for frame in range(FRAMES)]
    (result / "report.json").write_text("not JSON")
    assert data_of(report_page(result))["timings"]["stages"] == []


def test_writing_again_replaces_the_page_and_leaves_nothing_else(result):
    before = set(os.listdir(result))
    report_page(result).write_text("old")
    assert report_page(result).stat().st_size > 1000
    assert set(os.listdir(result)) == before | {"report.html"}


def test_what_is_no_result_is_refused(tmp_path):
    with pytest.raises(InputError, match="is not a result"):
        report_page(tmp_path)
    with pytest.raises(InputError, match="is not a folder"):
        report_page(tmp_path / "nowhere")


# The pictures -----------------------------------------------------------------------------------------------------


def test_pictures_are_the_frames_of_the_overlay_videos(result):
    data = data_of(report_page(result))
    assert data["views"] == ["left", "right"]
    assert data["positions"] == list(range(FRAMES))
    for view in (0, 1):
        for position in (0, 5, 11):
            shown = picture(data["pictures"][view][position])
            assert shown.shape == (80, 120, 3)
            assert abs(float(shown.mean()) - (10 * position + 40 + 20 * view)) < 4


def test_pictures_fit_into_their_budget_by_leaving_frames_out(result):
    motion = Motion.load(result)
    whole = report_pictures(result, motion, None)
    size = sum(len(uri) for view in whole.pictures for uri in view)
    half = report_pictures(result, motion, None, budget=size // 3)
    assert half.positions == tuple(range(0, FRAMES, half.positions[1]))
    assert half.positions[1] > 1
    assert abs(float(picture(half.pictures[1][1]).mean()) - (10 * half.positions[1] + 60)) < 4


def test_large_pictures_are_made_smaller(tmp_path):
    noise = np.random.default_rng(0).integers(0, 255, (450, 800, 3), np.uint8)
    write_overlay_video(tmp_path / "overlay_left.mp4", [(t / 30, noise) for t in range(FRAMES)])
    motion = judged(cameras=cameras(("left",)))
    tight = report_pictures(tmp_path, motion, None, budget=400_000)
    assert picture(tight.pictures[0][0]).shape[1] < 800
    assert sum(len(uri) for uri in tight.pictures[0]) * 3 / 4 < 1.2 * 400_000


def test_a_result_without_videos_or_cameras_says_why_it_has_no_pictures(tmp_path):
    said = []
    page = report_page(judged().save(tmp_path / "one"), say=said.append)
    assert "there is no overlay_left.mp4 with 12 frames, and no capture to draw them from" in said[0]
    assert "No pictures: there is no overlay_left.mp4" in Parsed(page.read_text()).text
    gone = {"lost": [], "capture": str(tmp_path / "gone")}
    assert "gone" in Parsed(report_page(judged(provenance=gone).save(tmp_path / "two")).read_text()).text
    blind = replace(judged(), cameras=None)
    assert "no cameras" in Parsed(report_page(blind.save(tmp_path / "three")).read_text()).text


def test_a_video_of_another_length_is_not_taken_for_the_motions(result):
    (result / "overlay_left.mp4").unlink()
    grey_videos(result, ("left",), frames=5)
    assert "with 12 frames" in Parsed(report_page(result).read_text()).text


def test_a_video_that_was_cut_short_is_drawn_anew_where_the_world_was_tracked(tmp_path):
    """The capture has been calibrated anew since: its world lies elsewhere."""
    shown = make_capture(4, (160, 90))
    motion = Motion.from_poses(
        shown.character, shown.poses, np.arange(4), shown.timestamps, cameras=shown.cameras, provenance={"lost": []}
    )
    result = motion.save(tmp_path / "result")
    (result / "overlay_cam0.mp4").write_bytes(b"cut")
    moved = shown.cameras.cam_from_world.at[..., 0, 3].add(1.0)
    now = write_capture(replace(shown, cameras=replace(shown.cameras, cam_from_world=moved)), tmp_path / "capture")
    drawn = picture(data_of(report_page(result, capture=Capture.open(now)))["pictures"][0][1])[..., ::-1].astype(float)
    changed, person = np.abs(drawn - shown.images[1][0].astype(float)).mean(-1), shown.masks[1][0]
    assert changed[person].mean() > 3 * changed[~person].mean()


def test_without_overlay_videos_pictures_are_drawn_over_the_capture(tmp_path):
    shown = make_capture(4, (160, 90))
    folder = write_capture(shown, tmp_path / "capture")
    motion = Motion.from_poses(
        shown.character, shown.poses, np.arange(4), shown.timestamps, cameras=shown.cameras,
        provenance={"capture": str(folder), "lost": []},
    )[1:]  # fmt: skip
    result = motion.save(tmp_path / "result")
    for given in (None, Capture.open(folder)):
        data = data_of(report_page(result, capture=given))
        person = shown.masks[2][1]
        drawn = picture(data["pictures"][1][1])[..., ::-1].astype(float)
        plain = shown.images[2][1].astype(float)
        changed = np.abs(drawn - plain).mean(-1)
        assert changed[person].mean() > 3 * changed[~person].mean()
