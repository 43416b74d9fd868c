"""A known length tells a scan's scale: marks projected by true cameras into views whose scale is wrong."""

import json
from dataclasses import replace
from types import SimpleNamespace

import cv2
import jax
import numpy as np
import pytest
from small_captures import look_at_pose

from jaxmocap._cli import run as command
from jaxmocap._results import InputError
from jaxmocap.camera import Cameras, write_cameras
from jaxmocap.capture import Undistortion
from jaxmocap.observation import MaskConfidence
from jaxmocap.pipeline import _scan, _scan_views, scan
from jaxmocap.pipeline._scan_length import KnownLength
from jaxmocap.pipeline._scan_masks import Outlines
from jaxmocap.pipeline._scan_views import ASSUMED, read_views
from jaxmocap.registration import PersonMask
from jaxmocap.viewers import open_video

SIZE, FOCAL, COUNT, WRONG = (320, 240), 300.0, 8, 1.3
NAMES = tuple(f"view{number}" for number in range(COUNT))
DOOR = np.array([[0.7, 0.1, 0.3], [0.5, 1.8, 0.2]])
METRES = float(np.linalg.norm(DOOR[1] - DOOR[0]))
SHOWN = ("view0", "view1", "view7")


@pytest.fixture(scope="module")
def cameras() -> Cameras:
    """True cameras around the origin, by a lens that distorts by some pixels."""
    intrinsics = np.tile([[FOCAL, 0, SIZE[0] / 2], [0, FOCAL, SIZE[1] / 2], [0, 0, 1]], (COUNT, 1, 1))
    poses = np.stack([look_at_pose(45.0 * number, 3.2, 1.2) for number in range(COUNT)])
    distortion = np.tile([-0.12, 0.02, 0, 0, 0], (COUNT, 1))
    arrays = jax.device_put([one.astype(np.float32) for one in (intrinsics, distortion, poses[:, None])])
    return Cameras(NAMES, (SIZE,) * COUNT, *arrays)


def scaled(cameras: Cameras, factor: float) -> Cameras:
    return replace(cameras, cam_from_world=cameras.cam_from_world.at[..., :3, 3].multiply(factor))


def marked(cameras: Cameras, recorded: bool = True, ends: np.ndarray = DOOR, pictures: tuple[str, ...] = SHOWN):
    """Where true cameras see the ends, in pixels of recorded pictures or of those without distortion."""
    marks = {}
    for name in pictures:
        number = NAMES.index(name)
        pose, k, d = (
            np.asarray(one, np.float64)
            for one in (cameras.cam_from_world[number, 0], cameras.intrinsics[number], cameras.distortion[number])
        )
        image = (ends @ pose[:3, :3].T + pose[:3, 3]) @ k.T
        pixels = image[:, :2] / image[:, 2:]
        pixels = Undistortion(k, d, SIZE).recorded_points(pixels) if recorded else pixels
        marks[name] = tuple(tuple(map(float, pixel)) for pixel in pixels)
    return marks


@pytest.fixture
def folder(cameras, tmp_path):
    """Pictures and masks of something upright, and cameras that are too far apart by `WRONG`."""
    rng, mask = np.random.default_rng(0), np.zeros(SIZE[::-1], np.uint8)
    cv2.ellipse(mask, (160, 125), (30, 85), 0, 0, 360, 255, -1)
    for part in ("pictures", "masks"):
        (tmp_path / part).mkdir()
    for name in NAMES:
        picture = rng.integers(0, 256, (*SIZE[::-1], 3)).astype(np.uint8)
        cv2.imwrite(str(tmp_path / "pictures" / f"{name}.png"), picture)
        cv2.imwrite(str(tmp_path / "masks" / f"{name}.png"), mask)
    write_cameras(scaled(cameras, WRONG), tmp_path / "cameras.toml", "aniposelib")
    return tmp_path


def read(folder, marks, **options):
    told = {"cameras": folder / "cameras.toml", "masks": folder / "masks"} | options
    return read_views(folder / "pictures", **told, length=KnownLength(METRES, marks))


@pytest.mark.parametrize("larger", [1, 3])
def test_the_scale_comes_back_from_marks_in_recorded_pictures(cameras, larger):
    marks = {name: tuple(map(tuple, larger * np.array(ends))) for name, ends in marked(cameras).items()}
    told = KnownLength(METRES, marks)
    found, measured = told.scale(NAMES, scaled(cameras, 0.37), (larger * SIZE[0], larger * SIZE[1]))
    np.testing.assert_allclose(found.cam_from_world, cameras.cam_from_world, atol=2e-4)
    assert measured.metres == METRES
    assert measured.pictures == 3
    assert measured.off_pixels < 0.05 * larger
    straight = KnownLength(METRES, marked(cameras, recorded=False)).scale(NAMES, cameras, SIZE)
    assert abs(np.linalg.norm(straight[0].cam_from_world[0, 0, :3, 3]) / 3.2 - 1) > 0.004, "the lens hardly distorts"


def test_the_report_says_what_a_pixel_of_error_changes(cameras):
    told = KnownLength(METRES, marked(cameras))
    measured = told.scale(NAMES, cameras, SIZE)[1]
    rng, distances = np.random.default_rng(0), []
    for _ in range(80):
        moved = {name: np.array(ends) + 0.2 * rng.standard_normal((2, 2)) for name, ends in told.marks.items()}
        found = KnownLength(METRES, moved).scale(NAMES, cameras, SIZE)[0]
        distances.append(float(np.linalg.norm(found.cam_from_world[0, 0, :3, 3])))
    assert measured.percent_per_pixel == pytest.approx(500 * np.std(distances) / np.mean(distances), rel=0.2)


def test_views_are_as_large_as_the_length_says_and_stay_so_when_they_are_kept(folder, cameras, tmp_path):
    shown = read(folder, marked(cameras), keep_views=tmp_path / "kept")
    np.testing.assert_allclose(shown.views.cam_from_world, cameras.cam_from_world[:, 0], atol=2e-4)
    assert (shown.height, shown.scale["from"], shown.scale["pictures"]) == (None, "known length", 3)
    again = read_views(tmp_path / "kept")
    assert np.array_equal(again.views.cam_from_world, shown.views.cam_from_world)
    assert again.scale == shown.scale
    with pytest.raises(InputError, match=r"a known length tells the scale of the views in .*kept; leave --height out"):
        read_views(tmp_path / "kept", height=1.7)


def test_a_length_in_kept_pictures_replaces_the_height_that_was_told(folder, cameras, tmp_path):
    told = {"cameras": folder / "cameras.toml", "masks": folder / "masks", "height": 1.5}
    guessed = read_views(folder / "pictures", **told, keep_views=tmp_path / "kept")
    assert (guessed.height, guessed.scale) == (1.5, {"from": "height"})
    length = KnownLength(METRES, marked(cameras, recorded=False))
    shown = read_views(tmp_path / "kept", length=length, keep_views=tmp_path / "more")
    np.testing.assert_allclose(shown.views.cam_from_world, cameras.cam_from_world[:, 0], atol=2e-4)
    assert json.loads((tmp_path / "more" / "views.json").read_text())["height_m"] is None
    assert read_views(tmp_path / "more").scale == shown.scale


def test_outlines_are_found_around_an_assumed_body_and_the_length_tells_the_scale(folder, cameras, monkeypatch):
    used, heights = (0, 1, 2, 3, 4, 5, 7), []

    def find(files, cameras, height, *_):
        heights.append(height)
        mask = cv2.imread(str(folder / "masks" / "view0.png"), cv2.IMREAD_GRAYSCALE) > 0
        masks = np.stack([mask] * len(used))
        people = (PersonMask(masks[0], MaskConfidence(0.9, 1.6, 0.7)),) * len(used)
        return Outlines(used, masks, people, scaled(cameras, 1.7).only(used))

    monkeypatch.setattr(_scan_views, "find_outlines", find)
    shown = read(folder, marked(cameras), masks=None)
    assert heights == [ASSUMED]
    assert shown.names == tuple(NAMES[number] for number in used)
    np.testing.assert_allclose(shown.views.cam_from_world, cameras.cam_from_world[[*used], 0], atol=2e-4)


def test_pixels_are_those_of_the_pictures_before_they_were_made_smaller(folder, cameras, monkeypatch):
    """Where no cameras are given they are found in smaller pictures, and called otherwise."""
    small = scaled(cameras.resized(((160, 120),) * COUNT), 0.2)
    left = [number for number in range(COUNT) if number != 7]

    def place(files, size, **_):
        assert size == (160, 120)
        names = tuple(f"{number:05d}" for number in left)
        return SimpleNamespace(
            cameras=replace(small.only(left), names=names), names=[files[one].name for one in left], left_out=["view7"]
        )

    monkeypatch.setattr(_scan_views, "LONGEST", 160)
    monkeypatch.setattr(_scan_views, "calibrate_pictures", place)
    shown = read(folder, marked(cameras), cameras=None)
    np.testing.assert_allclose(shown.views.cam_from_world, cameras.cam_from_world[left, 0], atol=2e-4)
    assert shown.length.pictures == 2
    with pytest.raises(InputError, match="is marked in view7, which could not be placed among the other pictures"):
        read(folder, marked(cameras, pictures=("view6", "view7")), cameras=None)


def test_neither_the_kept_nor_any_other_height_fixes_the_size_of_the_actor(folder, cameras, tmp_path, monkeypatch):
    told, made = {"cameras": folder / "cameras.toml", "masks": folder / "masks", "height": 1.5}, []

    def rig(mesh, **options):
        made.append((options["height"], options["units"]))
        raise InputError("seen enough")

    read_views(folder / "pictures", **told, keep_views=tmp_path / "kept")
    monkeypatch.setattr(_scan, "reconstruct", lambda *_, **__: SimpleNamespace(vertices=None, faces=None))
    monkeypatch.setattr(_scan, "rig", rig)
    heard: list[str] = []
    for known_length in (None, (METRES, marked(cameras, recorded=False))):
        with pytest.raises(InputError, match="seen enough"):
            scan(tmp_path / "kept", known_length=known_length, say=heard.append)
    assert made == [(1.5, None), (None, "m")]
    assert [one for one in heard if one.startswith("The known length tells the scale: its worst mark is off by 0.0")]


def moved(marks, name, by):
    return marks | {name: tuple(tuple(np.array(end) + by) for end in marks[name])}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            lambda marks: moved(marks, "view1", (0, -14)),
            "in view1 and the others do not show the same two ends: one",
        ),
        (lambda marks: marks | {"view7": marks["view7"][::-1]}, "in view7 and the others .* mark the same end first"),
        (
            lambda marks: moved({name: marks[name] for name in ("view0", "view1")}, "view0", (0, 14)),
            r"in view0 and view1 do not show the same two ends: one lies \d+ pixels",
        ),
        (lambda marks: {"view0": marks["view0"]}, "is marked in view0; mark both of its ends in two pictures or more"),
        (lambda marks: {}, "is marked in no picture; mark both"),
        (lambda marks: marks | {"view77": marks["view7"]}, "names 'view77', and the .* are called view0, view1, .* so"),
        (lambda marks: marks | {"view7": ((1, 2), (320.5, 9))}, "marks 320.5,9 in view7, outside of its 320 x 240 pix"),
        (lambda marks: marks | {"view7": ((1, 2), (1, 2))}, "marks one pixel twice in view7; mark the two ends"),
        (lambda marks: marks | {"view7": ((1, 2), (1, float("nan")))}, r"marks .*nan.* in view7; two pixels were exp"),
        (lambda marks: marks | {"view7": (1, 2)}, r"marks \(1, 2\) in view7; two pixels were expected, X,Y:X,Y"),
    ],
)
def test_marks_that_cannot_be_true_are_refused(folder, cameras, change, sentence, tmp_path):
    with pytest.raises(InputError, match=sentence):
        read(folder, change(marked(cameras)), keep_views=tmp_path / "kept")
    assert not (tmp_path / "kept").exists()


def test_views_of_nearly_one_line_and_ends_near_to_each_other_are_refused(cameras):
    close = replace(cameras, cam_from_world=cameras.cam_from_world.at[1].set(look_at_pose(3.0, 3.2, 1.2)[None]))
    with pytest.raises(InputError, match=r"view0 and view1 see the ends .* along lines only [34]\.\d degrees apart"):
        KnownLength(METRES, marked(close, pictures=("view0", "view1"))).scale(NAMES, close, SIZE)
    between = np.array([[0.05, 1.2, -0.6], [0.05, 1.2, 0.6]])
    with pytest.raises(InputError, match=r"view0 and view4 see the ends .* along lines only \d\.\d degrees apart"):
        KnownLength(1.2, marked(cameras, ends=between, pictures=("view0", "view4"))).scale(NAMES, cameras, SIZE)
    coin = np.array([[0.3, 0.5, 0.3], [0.3, 0.5, 0.4]])
    with pytest.raises(InputError, match=r"in view0, view1 and view7 are too near to each other: a pixel .* is \d+ %"):
        KnownLength(0.1, marked(cameras, ends=coin)).scale(NAMES, cameras, SIZE)


@pytest.mark.parametrize("metres", [0.02, 20.0, 203.0, -2.0, 0.0, float("nan"), float("inf")])
def test_a_length_that_nothing_has_is_refused(cameras, metres):
    with pytest.raises(InputError, match=r"--known-length is .*; metres were expected, 0\.02 to 20"):
        KnownLength(metres, marked(cameras))


def test_a_length_by_which_the_person_is_a_giant_is_refused(folder, cameras):
    with pytest.raises(InputError, match=r"with a known length of 17 m the person's silhouette is 1\d m across"):
        read_views(
            folder / "pictures",
            cameras=folder / "cameras.toml",
            masks=folder / "masks",
            length=KnownLength(17.0, marked(cameras)),
        )


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["two"], "--known-length has 'two'; METRES PICTURE:X,Y:X,Y PICTURE:X,Y:X,Y was expected, such as 2.03 view03"),
        (["view0:1,2:3,4", "view1:1,2:3,4"], "--known-length has 'view0:1,2:3,4'; METRES PICTURE:X,Y:X,Y"),
        (["2", "view0:1,2", "view1:1,2:3,4"], "--known-length has 'view0:1,2'; METRES"),
        (["2", "view0:1,2:3,4,5", "view1:1,2:3,4"], "--known-length has 'view0:1,2:3,4,5'; METRES"),
        (["2", "view0:1,2:3,four", "view1:1,2:3,4"], "--known-length has 'view0:1,2:3,four'; METRES"),
        (["2", "view0:1,2:3,4", "view0:1,2:3,4"], "--known-length marks view0 twice; give every picture once"),
        (["2"], "--known-length is marked in no picture"),
        (["0.01", "view0:1,2:3,4", "view1:1,2:3,4"], "--known-length is 0.01; metres were expected"),
        (["2", "view0:1,2:3,4", "view1:1,2:3,4", "--height", "1.7"], "--height and --known-length both tell how large"),
    ],
)
def test_what_cannot_be_read_is_one_sentence_on_the_command_line(folder, options, sentence, capsys):
    out = folder / "her.glb"
    arguments = ["scan", str(folder / "pictures"), "--out", str(out), "--known-length", *options]
    assert command(arguments) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith(f"jaxmocap: {sentence}")
    assert not out.exists()


def test_for_a_video_the_two_steps_are_said(tmp_path, capsys):
    video = tmp_path / "walk.mp4"
    with open_video(video) as writer:
        for number in range(16):
            writer.write(number / 30, np.full((120, 160, 3), 128, np.uint8))
    marks = ["2.03", "frame000001:1,2:3,4", "frame000005:1,2:3,4"]
    assert command(["scan", str(video), "--out", str(tmp_path / "her.glb"), "--known-length", *marks]) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert said == (
        f"jaxmocap: --known-length is marked in pictures, and {video} is a video: scan it with --height METRES "
        "(a guess will do) and --keep-views DIR first, mark the length in DIR/pictures, then scan DIR with "
        "--known-length."
    )
