"""Balls seen from all around: hulls and surfaces whose radius is known."""

import struct

import cv2
import jax
import numpy as np
import pytest

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras, write_cameras
from jaxmocap.capture import index_video
from jaxmocap.geometry import face_components
from jaxmocap.pipeline import scan
from jaxmocap.pipeline._scan_pictures import in_place
from jaxmocap.pipeline._scan_views import read_views
from jaxmocap.scan import Views, overlaps, reconstruct, visual_hull
from jaxmocap.scan._hull import depth_inside, mask_distances

SIZE, FOCAL, AWAY, RADIUS = 160, 150.0, 1.0, 0.3
BALLS = np.array([[0.0, 0.0, 0.0], [0.0, 0.42, 0.0]])


def ring(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Cameras around the y axis that look at the origin: K and poses."""
    intrinsics = np.tile([[FOCAL, 0, SIZE / 2], [0, FOCAL, SIZE / 2], [0, 0, 1]], (count, 1, 1))
    poses = np.tile(np.eye(4), (count, 1, 1))
    for pose, angle in zip(poses, 2 * np.pi * np.arange(count) / count, strict=True):
        forward = -np.array([np.cos(angle), 0, np.sin(angle)])
        pose[:3, :3] = np.stack([np.cross(forward, [0, 1, 0]), [0, -1, 0], forward])
        pose[:3, 3] = [0, 0, AWAY]
    return intrinsics, poses


def seen(intrinsics, poses, balls=BALLS[:1], radius=RADIUS):
    """Views of balls that wear a pattern."""
    row, column = np.mgrid[:SIZE, :SIZE]
    pictures, masks = [], []
    for k, pose in zip(intrinsics, poses, strict=True):
        rays = np.stack([column + 0.5, row + 0.5, np.ones((SIZE, SIZE))], -1) @ np.linalg.inv(k).T @ pose[:3, :3]
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        centre, depth = -pose[:3, :3].T @ pose[:3, 3], np.full((SIZE, SIZE), np.inf)
        for ball in balls:
            towards = rays @ (ball - centre)
            room = towards**2 - ((ball - centre) ** 2).sum() + radius**2
            depth = np.minimum(depth, np.where(room > 0, towards - np.sqrt(np.maximum(room, 0)), np.inf))
        mask = np.isfinite(depth)
        point = centre + rays * np.where(mask, depth, 0)[..., None]
        waves = np.sin(point @ (30 * np.random.default_rng(2).standard_normal((3, 12)))).sum(-1)
        pictures.append(np.where(mask, np.clip(128 + 25 * waves, 1, 255), 60).astype(np.uint8))
        masks.append(mask)
    return Views(np.stack(pictures), np.stack(masks), intrinsics, poses)


def test_the_hull_of_a_ball_is_closed_and_holds_the_ball():
    vertices, faces = visual_hull(seen(*ring(8)), cell=0.02)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    assert face_components(faces)[0] == 1
    away = np.linalg.norm(vertices, axis=1)
    equator = np.abs(vertices[:, 1]) < 0.05
    assert away.min() > RADIUS - 0.004  # half a pixel is 3 mm there
    assert away[equator].max() < RADIUS / np.cos(np.pi / 8) + 0.005  # an octagon around a circle
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    assert np.einsum("fi,fi->f", np.cross(b - a, c - a), a).sum() > 0, "inside out"


def test_what_two_facing_views_alone_show_is_none_of_the_hull():
    """Between the ball and either of them, where the views from the side do not look."""
    views = seen(*ring(4))
    points = np.array([[0.0, 0, 0], [0.7, 0, 0], [0, 0, -0.7]])
    inside = depth_inside(points, mask_distances(views.masks), views.cameras) > 0
    assert inside.tolist() == [True, False, False]


@pytest.mark.slow
def test_pictures_draw_the_surface_in_to_the_ball():
    views = seen(*ring(10))
    errors = []
    for rounds in (0, 4):
        made = reconstruct(views, cell=0.02, rounds=rounds)
        equator = np.abs(made.vertices[:, 1]) < 0.1
        errors.append(np.abs(np.linalg.norm(made.vertices[equator], axis=1) - RADIUS).mean())
        assert made.overlap.min() > 0.97
    assert errors[0] > 0.004
    assert errors[1] < 0.5 * errors[0]


def test_a_mask_that_lacks_a_part_is_left_out_and_carves_nothing_off():
    cameras = ring(8)
    views = seen(*cameras, balls=BALLS, radius=0.15)
    masks = views.masks | cv2.line(np.zeros((SIZE, SIZE), np.uint8), (80, 80), (80, 25), 1, 6).astype(bool)  # a neck
    masks[3] = seen(*cameras, balls=BALLS[:1], radius=0.15).masks[3]
    made = reconstruct(views._replace(masks=masks), cell=0.02, rounds=0)
    assert made.used.tolist() == [True] * 3 + [False] + [True] * 4
    assert made.vertices[:, 1].max() > 0.5
    assert made.overlap[3] < 0.7


def test_silhouettes_of_different_places_have_nothing_in_common():
    views = seen(*ring(6), radius=0.05)
    apart = np.stack([np.roll(mask, 40 * (-1) ** view, axis=0) for view, mask in enumerate(views.masks)])
    with pytest.raises(InputError, match="no place in common"):
        reconstruct(views._replace(masks=apart), cell=0.02)
    with pytest.raises(InputError, match="4 views of the person are given; 5 all around are needed"):
        reconstruct(views.only(np.arange(6) < 4))


@pytest.mark.slow
def test_a_real_person_seen_by_eight_cameras_fits_the_masks_of_the_twelve_others(data):
    standing = data / "standing"
    if not standing.is_dir():
        pytest.skip(f"{standing} is not there")
    views = read_views(standing / "pictures", standing / "cameras", standing / "masks").views
    used = np.isin(np.arange(20), (0, 2, 5, 7, 10, 12, 15, 17))
    made = reconstruct(views.only(used))
    assert made.used.all()
    assert overlaps(made.vertices, made.faces, views.only(~used)).mean() > 0.93


@pytest.fixture
def folder(tmp_path):
    """Pictures, masks and a COLMAP model of one ball."""
    intrinsics, poses = ring(6)
    views = seen(intrinsics, poses)
    names = tuple(f"view{number}" for number in range(6))
    for kind, images in (("pictures", views.grey), ("masks", 255 * views.masks.astype(np.uint8))):
        (tmp_path / kind).mkdir()
        for name, image in zip(names, images, strict=True):
            cv2.imwrite(str(tmp_path / kind / f"{name}.png"), image)
    arrays = jax.device_put([a.astype(np.float32) for a in (intrinsics, np.zeros((6, 5)), poses[:, None])])
    write_cameras(Cameras(names, ((SIZE, SIZE),) * 6, *arrays), tmp_path / "cameras.toml", "aniposelib")
    return tmp_path


def scanned(folder, **other):
    places = {"cameras": folder / "cameras.toml", "masks": folder / "masks"} | other
    return scan(folder / "pictures", folder / "out.glb", **places)


@pytest.mark.slow
def test_a_ball_is_no_person(folder):
    with pytest.raises(InputError, match="person"):
        scanned(folder)
    assert not (folder / "out.glb").exists()


def test_what_is_wrong_with_the_files_is_said(folder):
    (folder / "masks" / "view2.png").rename(folder / "away.png")
    with pytest.raises(InputError, match=r"view2\.png has no mask; expected .*view2\.png"):
        scanned(folder)
    cv2.imwrite(str(folder / "masks" / "view2.png"), np.zeros((SIZE, SIZE), np.uint8))
    with pytest.raises(InputError, match=r"view2\.png is empty"):
        scanned(folder)
    cv2.imwrite(str(folder / "masks" / "view2.png"), np.zeros((SIZE, 80), np.uint8))
    with pytest.raises(InputError, match=r"view2\.png is 80x160 pixels, but view2\.png is 160x160"):
        scanned(folder)
    cv2.imwrite(str(folder / "pictures" / "view9.png"), np.zeros((SIZE, SIZE), np.uint8))
    (folder / "away.png").rename(folder / "masks" / "view2.png")
    with pytest.raises(InputError, match="say it with --height, or give --masks"):
        scanned(folder, masks=None)
    with pytest.raises(InputError, match="view9"):
        scanned(folder)
    with pytest.raises(InputError, match="does not exist; give a video, or the folder"):
        scan(folder / "nowhere", cameras=folder / "cameras.toml", masks=folder / "masks")


def test_too_few_pictures_are_refused_before_cameras_and_masks_are_looked_for(folder):
    for number in (4, 5):
        (folder / "pictures" / f"view{number}.png").unlink()
    with pytest.raises(InputError, match=r"pictures: 4 views of the person are given; 5 all around"):
        scanned(folder, cameras=folder / "none.toml")


@pytest.mark.parametrize("cameras", [None, "given"])
def test_a_picture_that_its_metadata_turns_is_one_for_everybody(cameras, tmp_path):
    """A phone stores an upright picture lying, and a note on how to turn it, which some programs read."""
    shown = np.zeros((80, 60, 3), np.uint8)
    shown[:40, :30] = (0, 0, 255)
    stored = np.ascontiguousarray(np.rot90(shown))
    plain = cv2.imencode(".jpg", stored)[1].tobytes()
    entry = struct.pack("<HHIHH", 0x0112, 3, 1, 6, 0)  # orientation 6: to be turned clockwise
    note = b"Exif\0\0II*\0" + struct.pack("<IH", 8, 1) + entry + struct.pack("<I", 0)
    file = tmp_path / "IMG 1.jpg"
    file.write_bytes(plain[:2] + b"\xff\xe1" + struct.pack(">H", len(note) + 2) + note + plain[2:])
    place = tmp_path / "place"
    place.mkdir()
    copy, size, scale = in_place(file, place, cameras is None, None)
    assert (copy, scale) == (place / file.name, 1.0)
    wanted = shown if cameras is None else stored
    for flags in (cv2.IMREAD_COLOR, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION):
        found = cv2.imread(str(copy), flags)
        assert found.shape == wanted.shape
        assert np.abs(found.astype(int) - wanted).mean() < 5
    assert index_video(copy).size == size == (wanted.shape[1], wanted.shape[0])
    (tmp_path / "plain.jpg").write_bytes(plain)
    assert in_place(tmp_path / "plain.jpg", place, True, None).file == tmp_path / "plain.jpg"
    smaller = in_place(file, place, cameras is None, 40)
    assert (smaller.size, smaller.scale) == (size, 0.5)
    assert cv2.imread(str(smaller.file)).shape == (wanted.shape[0] // 2, wanted.shape[1] // 2, 3)


def test_what_cannot_be_written_is_said_before_anything_is_looked_at(tmp_path):
    with pytest.raises(InputError, match="200 triangles were asked for"):
        scan(tmp_path / "nothing", height=1.7, num_faces=200)
    with pytest.raises(InputError, match=r"her\.obj: a scan is written as GLB"):
        scan(tmp_path / "nothing", tmp_path / "her.obj", height=1.7)
