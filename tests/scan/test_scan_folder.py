"""The views of a scan as a folder: written, corrected, and scanned again."""

import json

import cv2
import jax
import numpy as np
import pytest
from small_captures import look_at_pose

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras, write_cameras
from jaxmocap.observation import MaskConfidence
from jaxmocap.pipeline import _scan, _scan_views, scan
from jaxmocap.pipeline._scan_masks import Outlines
from jaxmocap.pipeline._scan_views import read_views
from jaxmocap.registration import PersonMask
from jaxmocap.scan import Views
from jaxmocap.scan._surface import draw_views
from jaxmocap.synthetic import make_actor

SIZE, COUNT, HEIGHT = (192, 256), 8, 1.75
SURE, UNSURE = MaskConfidence(0.9, 1.6, 0.7), MaskConfidence(0.55, 1.6, 0.7)


@pytest.fixture(scope="module")
def standing(tmp_path_factory):
    """Pictures of a grey person in colour noise by a lens that distorts a little, their cameras, and masks without."""
    actor = make_actor(HEIGHT)
    vertices = np.asarray(actor.vertices, float)
    vertices = vertices - [0, vertices[:, 1].min(), 0]
    intrinsics = np.tile([[260.0, 0, SIZE[0] / 2], [0, 260.0, SIZE[1] / 2], [0, 0, 1]], (COUNT, 1, 1))
    poses = np.stack([look_at_pose(angle, 2.4, 0.9) for angle in 360 * np.arange(COUNT) / COUNT])
    blank = np.zeros((COUNT, *SIZE[::-1]))
    drawn = draw_views(vertices, np.asarray(actor.faces), Views(blank.astype(np.uint8), blank > 0, intrinsics, poses))
    masks = np.stack([one.ids >= 0 for one in drawn])
    place, rng = tmp_path_factory.mktemp("standing"), np.random.default_rng(0)
    names = tuple(f"view{number}" for number in range(COUNT))
    for part in ("pictures", "masks"):
        (place / part).mkdir()
    for name, mask, one in zip(names, masks, drawn, strict=True):
        picture = rng.integers(0, 90, (*mask.shape, 3)).astype(np.uint8)
        picture[mask] = (100 + one.ids[mask] % 120)[:, None]
        cv2.imwrite(str(place / "pictures" / f"{name}.png"), picture)
        cv2.imwrite(str(place / "masks" / f"{name}.png"), 255 * mask.astype(np.uint8))
    distortion = np.tile([0.01, 0, 0, 0, 0], (COUNT, 1))
    arrays = jax.device_put([a.astype(np.float32) for a in (intrinsics, distortion, poses[:, None])])
    cameras = Cameras(names, (SIZE,) * COUNT, *arrays)
    write_cameras(cameras, place / "cameras.toml", "aniposelib")
    return place, masks, cameras


@pytest.fixture
def kept(standing, tmp_path, monkeypatch):
    """Views whose masks were found, and the folder that keeps them; nothing is looked for any more."""
    place, masks, _ = standing

    def find(files, cameras, *_):
        people = tuple(PersonMask(mask, UNSURE if number == 3 else SURE) for number, mask in enumerate(masks))
        return Outlines(tuple(range(COUNT)), masks, people, cameras)

    def refuse(*_):
        raise AssertionError("looked for again")

    monkeypatch.setattr(_scan_views, "find_outlines", find)
    told = {"cameras": place / "cameras.toml", "height": HEIGHT, "keep_views": tmp_path / "kept"}
    shown = read_views(place / "pictures", **told)
    monkeypatch.setattr(_scan_views, "find_outlines", refuse)
    return shown, tmp_path / "kept"


def test_a_picture_in_which_nobody_was_found_is_no_view(standing, monkeypatch):
    place, masks, _ = standing
    used = (0, 1, 2, 4, 5, 6, 7)

    def find(files, cameras, *_):
        return Outlines(used, masks[[*used]], (PersonMask(masks[0], SURE),) * len(used), cameras.only(used))

    monkeypatch.setattr(_scan_views, "find_outlines", find)
    shown = read_views(place / "pictures", cameras=place / "cameras.toml", height=HEIGHT)
    assert shown.names == tuple(f"view{number}" for number in used)
    every = read_views(place / "pictures", cameras=place / "cameras.toml", masks=place / "masks").views
    np.testing.assert_array_equal(shown.views.grey, every.grey[[*used]])
    np.testing.assert_array_equal(shown.views.intrinsics, every.intrinsics[[*used]])


def paint(file, where):
    """Change a mask as a paint program does: the file comes back in colour, with alpha."""
    mask = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
    mask[where] = 255 - mask[where]
    cv2.imwrite(str(file), cv2.cvtColor(mask, cv2.COLOR_GRAY2BGRA))


def test_what_was_kept_is_what_was_looked_at(kept):
    shown, folder = kept
    again = read_views(folder)
    assert again.names == shown.names
    assert (again.height, again.filmed, again.masks) == (HEIGHT, False, shown.masks)
    for was, now in zip(shown.views, again.views, strict=True):
        assert np.array_equal(was, now), "a scan of these views would be another one"
    record = json.loads((folder / "views.json").read_text())["views"]
    assert record["view3"]["mask"]["confidence"] == pytest.approx(UNSURE.value, abs=1e-3)
    assert record["view2"]["mask"] == {"source": "found", "confidence": 1.0} | SURE._asdict()
    overlay = cv2.imread(str(folder / "overlays" / "view0.png"))
    outside = ~cv2.dilate(shown.views.masks[0].astype(np.uint8), np.ones((5, 5))).astype(bool)
    picture = cv2.imread(str(folder / "pictures" / "view0.png"))
    assert np.array_equal(overlay[outside], picture[outside] // 2)


def test_a_corrected_mask_counts_and_the_others_stay(kept, tmp_path):
    shown, folder = kept
    corner = np.s_[:20, :20]
    paint(folder / "masks" / "view3.png", corner)
    again = read_views(folder, keep_views=tmp_path / "more")
    changed = shown.views.masks.copy()
    changed[3][corner] ^= True
    assert np.array_equal(again.views.masks, changed)
    assert [one["source"] for one in again.masks] == ["found"] * 3 + ["corrected"] + ["found"] * 4
    more = read_views(tmp_path / "more")
    assert np.array_equal(more.views.masks, changed)
    assert more.masks == again.masks


def test_a_view_whose_picture_is_deleted_is_left_out(kept):
    shown, folder = kept
    (folder / "pictures" / "view5.png").unlink()
    again = read_views(folder)
    assert again.names == shown.names[:5] + shown.names[6:]
    assert np.array_equal(again.views.cam_from_world, np.delete(shown.views.cam_from_world, 5, axis=0))


def test_views_with_masks_that_were_given_take_the_height_later(standing, tmp_path):
    place, _, cameras = standing
    given = {"cameras": place / "cameras.toml", "masks": place / "masks"}
    shown = read_views(place / "pictures", **given, keep_views=tmp_path / "kept")
    assert (shown.height, shown.masks[0]) == (None, {"source": "given"})
    told, later = read_views(place / "pictures", **given, height=2.0), read_views(tmp_path / "kept", height=2.0)
    assert np.array_equal(told.views.cam_from_world, later.views.cam_from_world)
    assert not np.allclose(later.views.cam_from_world, np.asarray(cameras.cam_from_world)[:, 0])


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"height": 1.6}, r"kept is of somebody 1\.75 m tall, and the height that is given is 1\.6 m"),
        ({"cameras": "cameras.toml"}, r"leave --cameras out, and correct masks in .*masks"),
        ({"masks": "masks"}, "leave --masks out"),
        ({"focal": 300.0}, "leave --focal out"),
    ],
)
def test_what_does_not_go_with_kept_views_is_refused(kept, options, sentence, tmp_path):
    with pytest.raises(InputError, match=sentence):
        read_views(kept[1], **options, keep_views=tmp_path / "more")
    assert not (tmp_path / "more").exists()


def test_a_folder_that_is_not_as_it_was_written_gets_a_sentence(kept, standing):
    folder = kept[1]
    with pytest.raises(InputError, match="kept exists already; choose a new or an empty folder with --keep-views"):
        read_views(standing[0] / "pictures", height=HEIGHT, keep_views=folder)
    (folder / "masks" / "view1.png").unlink()
    with pytest.raises(InputError, match=r"view1\.png has no mask; expected .*view1\.png"):
        read_views(folder)
    cv2.imwrite(str(folder / "masks" / "view1.png"), np.full((9, 9), 255, np.uint8))
    with pytest.raises(InputError, match=r"view1\.png is 9x9 pixels, but view1\.png is 192x256"):
        read_views(folder)
    record = (folder / "views.json").read_text()
    for name in ("../view1", "/view1"):
        (folder / "views.json").write_text(record.replace('"view1"', f'"{name}"'))
        with pytest.raises(InputError, match=r"views\.json names a view '\.?\.?/view1', a path"):
            read_views(folder)
    for text in ("{", '{"views": {}}', '{"filmed": false, "height_m": null, "views": {"a": {"mask": {}}}}'):
        (folder / "views.json").write_text(text)
        with pytest.raises(InputError, match=r"views\.json is not what a scan wrote: .*scan the video or the pictures"):
            read_views(folder)


def test_masks_are_kept_and_doubts_are_told_before_the_surface_fails(kept, standing, tmp_path, monkeypatch):
    def fail(*_, **__):
        raise InputError("no surface")

    monkeypatch.setattr(_scan, "reconstruct", fail)
    heard = []
    with pytest.raises(InputError, match="no surface"):
        scan(kept[1], keep_views=tmp_path / "more", say=heard.append)
    doubt = f"The outline is doubtful in view3 ({UNSURE.value:.2f}): correct {tmp_path / 'more' / 'masks'} and scan "
    assert heard == [doubt + f"{tmp_path / 'more'}."]
    assert read_views(tmp_path / "more").names == kept[0].names


@pytest.mark.slow
def test_kept_views_give_the_same_actor_and_corrected_ones_another(kept, tmp_path):
    shown, folder = kept
    made = [scan(folder, tmp_path / name / "her.glb", keep_views=tmp_path / name / "views") for name in ("a", "b")]
    assert made[0].report["scale"] == {"from": "height"}
    actor = (tmp_path / "a" / "her.glb").read_bytes()
    assert scan(tmp_path / "a" / "views", tmp_path / "c" / "her.glb").report == made[0].report
    assert actor == (tmp_path / "b" / "her.glb").read_bytes() == (tmp_path / "c" / "her.glb").read_bytes()
    row, _ = np.nonzero(shown.views.masks[3])
    low = np.s_[int(np.quantile(row, 0.8)) :, :]
    mask = np.zeros_like(shown.views.masks[3])
    mask[low] = shown.views.masks[3][low]
    paint(tmp_path / "a" / "views" / "masks" / "view3.png", mask)
    lacking = scan(tmp_path / "a" / "views", tmp_path / "d" / "her.glb")
    assert (tmp_path / "d" / "her.glb").read_bytes() != actor
    assert lacking.report["left_out"] == ["view3"]
    assert lacking.report["masks"]["view3"] == {"source": "corrected"}
