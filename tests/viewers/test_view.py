"""The viewer: what it shows at each frame, whom it lets in, and what it says about what is not there."""

import threading
import time
import urllib.request
from collections import defaultdict
from dataclasses import replace

import av
import cv2
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxmocap._cli import run
from jaxmocap._results import InputError
from jaxmocap.camera import Cameras
from jaxmocap.character import Pose, angles_at_rest
from jaxmocap.motion import Motion
from jaxmocap.synthetic import make_actor, make_capture, write_capture
from jaxmocap.viewers import _turntable as turntable, view, write_rerun
from jaxmocap.viewers._first_view import FIELD_OF_VIEW, first_view
from jaxmocap.viewers._limb_trust import body_status, words_about
from jaxmocap.viewers._shown import gather
from jaxmocap.viewers._turntable import draw_scene

FRAMES = 4


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A synthetic capture on disk, and its true motion as a result."""
    shown = make_capture(FRAMES, (160, 90))
    folder = write_capture(shown, tmp_path_factory.mktemp("world") / "capture")
    told = {"capture": str(folder), "truth": str(folder / "truth.npz")}
    status = ["ok", "doubtful", "lost", "ok"]
    energy = {"model_view": np.array([0.2, np.nan, 0.4, 0.1])}
    motion = Motion.from_poses(
        shown.character, shown.poses, np.arange(FRAMES), shown.timestamps,
        cameras=shown.cameras, provenance=told, status=status, energy=energy,
    )  # fmt: skip
    return shown, motion


# What is gathered -------------------------------------------------------------------------------------------------


def test_images_and_truth_are_those_of_the_motions_frames(world):
    shown, motion = world
    gathered = gather(motion[1:])
    assert gathered.missing == ()
    for index in range(3):
        image = gathered.image(1, index)
        assert image is not None
        assert np.abs(image.astype(int) - shown.images[index + 1, 1]).mean() < 8  # the video is compressed
        np.testing.assert_allclose(gathered.truth[index], shown.markers[index + 1], atol=1e-5)


def test_a_second_result_stands_beside_the_first_on_the_same_ground(world):
    _, motion = world
    gathered = gather(motion)
    roll = np.eye(4)
    roll[:2, :2] = [[0.9, -0.4359], [0.4359, 0.9]]  # a phone that is held askew
    askew = (roll @ np.asarray(motion.cameras.cam_from_world)).astype(np.float32)
    cameras = replace(motion.cameras, cam_from_world=askew)
    for shown in (gathered, replace(gathered, motion=replace(motion, cameras=cameras))):
        aside = np.array(shown.aside())
        assert aside["xyz".index(motion.up)] == 0
        assert np.linalg.norm(aside) == pytest.approx(1.5, abs=1e-5)


def test_pictures_are_found_by_the_cameras_names(world, tmp_path):
    """In another order, and with one of them gone."""
    shown, motion = world
    folder = write_capture(shown, tmp_path / "capture")
    told = (folder / "capture.toml").read_text()
    head, first, second = (part.strip() for part in told.split("[[camera]]"))
    turned = head + f"\n\n[[camera]]\n{second}\n\n[[camera]]\n{first}\n"
    (folder / "capture.toml").write_text(turned)
    image = gather(motion, capture=folder).image(1, 2)
    assert np.abs(image.astype(int) - shown.images[2, 1]).mean() < 8
    other = replace(motion, cameras=replace(motion.cameras, names=("cam0", "gone")))
    assert "Camera gone of the result is not among those" in gather(other).missing[0]


def test_a_recorded_truth_that_is_damaged_is_done_without(world, tmp_path):
    _, motion = world
    (tmp_path / "truth.npz").write_bytes(b"none")
    gathered = gather(replace(motion, provenance=motion.provenance | {"truth": str(tmp_path / "truth.npz")}))
    assert gathered.truth is None
    assert "shown without the truth" in gathered.missing[0]


def test_a_truth_in_another_world_is_brought_to_the_motions(world, tmp_path):
    shown, motion = world
    turn, shift = Rotation.from_rotvec([0.3, 1.0, -0.2]).as_matrix(), np.array([4.0, -1.0, 2.0])
    moved = np.asarray(shown.cameras.cam_from_world, np.float64).copy()
    moved[..., :3, :3] = moved[..., :3, :3] @ turn.T  # cam_from_truth = cam_from_world world_from_truth
    moved[..., :3, 3] -= moved[..., :3, :3] @ shift
    markers = shown.markers @ turn.T + shift
    moved[0, 1, 0, 0] = np.nan
    np.savez(tmp_path / "truth.npz", markers=markers, cam_from_world=moved)
    gathered = gather(motion, truth=tmp_path / "truth.npz")
    np.testing.assert_allclose(gathered.truth, shown.markers, atol=1e-3)


def test_a_second_motion_is_matched_by_frame(world):
    _, motion = world
    gathered = gather(motion[1:3], other=motion[2:])
    assert [gathered.other_at(index) for index in range(2)] == [None, 0]
    with pytest.raises(InputError, match="no frame in common"):
        gather(motion[:1], other=motion[2:])


def test_what_is_gone_is_said_and_what_is_given_and_wrong_is_refused(world, tmp_path):
    _, motion = world
    gone = {"capture": str(tmp_path / "gone"), "truth": str(tmp_path / "gone.npz")}
    gathered = gather(replace(motion, provenance=gone))
    assert gathered.image(0, 0) is None
    assert gathered.missing[0].startswith("It is shown without images: ")
    assert "gone.npz is no longer there" in gathered.missing[1]
    assert "does not say in which capture" in gather(replace(motion, provenance={})).missing[0]
    with pytest.raises(InputError, match="nowhere"):
        gather(motion, capture=tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"nowhere\.npz"):
        gather(motion, truth=tmp_path / "nowhere.npz")


# The page ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def viewer(world):
    pytest.importorskip("viser", reason="viser, of the extra 'view', is not installed")
    _, motion = world
    turned = Rotation.from_rotvec([0, 0.5, 0]).as_matrix()
    root = motion.root.copy()
    root[:, :3, :3] = turned @ root[:, :3, :3]
    served = view(motion, other=replace(motion, root=root)[1:], port=18733)
    yield served
    served.stop()


def test_only_this_machine_is_let_in_unless_asked_otherwise(viewer):
    assert viewer.url.startswith("http://127.0.0.1:")
    with urllib.request.urlopen(viewer.url, timeout=10) as page:
        assert b"<html" in page.read(2000).lower()


def test_the_legend_names_the_colours_that_are_shown(viewer, world):
    _, motion = world
    assert viewer._legend.content.endswith("Violet: the second result. Green: the truth.")
    alone = view(replace(motion, provenance={}), port=18753)
    try:
        assert "Blue: found." in alone._legend.content
        assert not {"Violet:", "Green:"} & set(alone._legend.content.split())
    finally:
        alone.stop()


def test_every_frame_shows_its_pose_its_images_and_its_status(viewer, world):
    shown, motion = world
    for index in (2, 1, 3, 0):
        viewer.go(index)
        assert viewer._slider.value == index
        np.testing.assert_allclose(
            viewer._body.parts[str(motion.status[index])].vertices, motion.vertices(index), atol=1e-5
        )
        np.testing.assert_allclose(viewer._truth.cloud.points, shown.markers[index], atol=2e-3)  # float16 on the wire
        assert viewer._says.value.endswith(f"s, {motion.status[index]}")
        ends = viewer._bones.points[0]
        pelvis, spine = (motion.joints[index, motion.joint_names.index(name)] for name in ("pelvis", "spine"))
        np.testing.assert_allclose(ends, [pelvis, spine], atol=1e-6)
        np.testing.assert_allclose(viewer._cameras.frusta[1].position, shown.cameras.centres()[1, index], atol=1e-4)
        assert viewer._other.mesh.visible == (index > 0)


def test_toggles_hide_what_they_name(viewer):
    viewer.go(1)
    pairs = {
        "_with_mesh": viewer._body.parts["doubtful"],
        "_with_bones": viewer._bones,
        "_with_truth": viewer._truth.cloud,
        "_with_other": viewer._other.mesh,
        "_with_cameras": viewer._cameras.frusta[0],
    }
    for name, handle in pairs.items():
        toggle = getattr(viewer, name)
        for value in (False, True):
            toggle.value = value
            viewer._redraw()
            assert handle.visible == value, name
    viewer._opacity.value = 0.5
    viewer._redraw()
    assert viewer._body.parts["doubtful"].opacity == 0.5


def test_a_second_result_stands_to_the_right_when_side_by_side(viewer, world):
    shown, _ = world
    right = np.array(shown.cameras.cam_from_world[0, 0, 0, :3])
    right[1] = 0.0  # up
    right /= np.linalg.norm(right)
    viewer.go(1)  # the second result has no frame 0
    for beside, expected in ((True, 1.5 * right), (False, np.zeros(3))):
        viewer._beside.value = beside
        viewer._redraw()
        np.testing.assert_allclose(viewer._other.mesh.position, expected, atol=1e-5)


def test_the_picture_seen_through_a_camera_lies_where_the_camera_saw_it(viewer, world):
    shown, motion = world
    viewer.go(3)
    viewer._eye.value = shown.cameras.names[1]
    viewer._redraw()
    screen, (width, height) = viewer._cameras.screens[1], shown.size
    assert screen.visible
    assert not viewer._cameras.screens[0].visible
    assert not viewer._cameras.frusta[0].visible
    turn = Rotation.from_quat(screen.wxyz, scalar_first=True).as_matrix()
    half = np.array([screen.render_width / 2, screen.render_height / 2, 0.0])
    view_ = shown.cameras.at(3)
    for corner, pixel in (((-1, -1, 0), (0, 0)), ((1, 1, 0), (width, height))):
        place = turn @ (half * corner) + screen.position
        seen = np.asarray(view_.intrinsics[1]) @ (np.asarray(view_.cam_from_world[1]) @ [*place, 1])[:3]
        np.testing.assert_allclose(seen[:2] / seen[2], pixel, atol=0.05)
    assert np.linalg.norm(screen.position - motion.joints[3].mean(0)) > 1  # behind the person
    viewer._eye.value = "free"
    viewer._redraw()
    assert not screen.visible


def test_it_plays_over_and_over(viewer):
    viewer.go(0)
    viewer.play(True)
    seen = set()
    for _ in range(400):
        seen.add(viewer.position)
        viewer._stopped.wait(0.01)
        if seen == set(range(FRAMES)):
            break
    viewer.play(False)
    assert seen == set(range(FRAMES))


def test_curves_have_no_gaps_for_the_page_cannot_draw_them(viewer):
    viewer.go(2)
    plot, _ = viewer._curves.plots[0]
    frames, energy, now = plot.data
    np.testing.assert_array_equal(frames, [0, 1, 2, 3])
    np.testing.assert_allclose(energy * 0.2, [0.2, 0.3, 0.4, 0.1])  # over its median
    assert np.argmax(now) == 2


# The command ------------------------------------------------------------------------------------------------------


def test_the_command_refuses_what_it_cannot_show(tmp_path, capsys, world):
    _, motion = world
    motion.save(tmp_path / "result")
    for arguments, words in (
        ([tmp_path / "nowhere"], "is not a result"),
        ([tmp_path / "result", "--port", "99999"], "from 0 to 65535"),
        ([tmp_path / "result", "--rerun", tmp_path / "x.mp4"], "ends in .rrd"),
        ([tmp_path / "result", "--host", "203.0.113.7"], "no address of this machine"),
    ):
        assert run(["view", *map(str, arguments)]) == 2
        assert words in capsys.readouterr().err


def test_without_its_packages_the_viewers_say_what_to_install(world, monkeypatch, tmp_path):
    _, motion = world
    for name in ("viser", "rerun"):
        monkeypatch.setitem(__import__("sys").modules, name, None)
    with pytest.raises(InputError, match=r"pip install 'jaxmocap\[view\]'"):
        view(motion)
    with pytest.raises(InputError, match=r"pip install 'jaxmocap\[rerun\]'"):
        write_rerun(motion, tmp_path / "x.rrd")
    assert not (tmp_path / "x.rrd").exists()


def rows_of(path) -> dict[str, int]:
    """How often each entity was logged, as Rerun itself reads a recording, whose parts may be compressed."""
    rows = defaultdict(int)
    try:
        from rerun.chunk import RrdReader
    except ImportError:  # older versions have another reader
        from rerun.dataframe import load_recording

        recording = load_recording(path)
        for name in {one.entity_path for one in recording.schema().component_columns() if not one.is_static}:
            rows[name] = recording.view(index="frame", contents=name).select().read_all().num_rows
        return rows
    for chunk in RrdReader(path).stream():
        rows[chunk.entity_path] += chunk.num_rows
    return rows


def test_a_recording_for_rerun_holds_every_frame(world, tmp_path):
    pytest.importorskip("rerun", reason="rerun-sdk, of the extra 'rerun', is not installed")
    _, motion = world
    path, missing = write_rerun(motion, tmp_path / "x.rrd", other=motion[1:])
    assert missing == ()
    rows = rows_of(path)
    for name in ("result/mesh", "result/skeleton", "truth", "cameras/cam0", "cameras/cam1"):
        assert rows[f"/world/{name}"] == FRAMES
    assert rows["/world/second_result/mesh"] == FRAMES - 1
    assert rows["/energy/model_view"] == FRAMES - 1  # one is unknown
    assert rows["/world/cameras/cam1/image"] >= FRAMES  # picture and lens may be rows of their own
    with pytest.raises(InputError, match="exists already"):
        write_rerun(motion, path)


def test_motions_without_cameras_or_truth_are_shown_too(world):
    pytest.importorskip("viser", reason="viser, of the extra 'view', is not installed")
    _, motion = world
    bare = replace(motion, cameras=None, provenance={}, energy={})
    served = view(bare[:1], port=18833)
    try:
        assert isinstance(motion.cameras, Cameras)
        assert served._cameras.frusta == []
        assert served._truth is None
        served.go(5)
        assert served.position == 0
    finally:
        served.stop()


# The first view, the limbs that are not trusted, and the movie ------------------------------------------------------


def test_the_first_view_holds_person_ground_and_cameras_and_no_camera_stands_before_the_person(world):
    shown = gather(world[1])
    people, frusta, axis = shown.scene(0)
    extent = np.ptp(np.concatenate([people, frusta[:, 0]]), axis=0).max()
    sides = [np.linalg.norm(f[1:] - np.roll(f[1:], 1, axis=0), axis=1).max() for f in frusta]
    depths = [np.linalg.norm(f[1:].mean(axis=0) - f[0]) for f in frusta]
    np.testing.assert_allclose(np.maximum(sides, depths), 0.1 * extent, rtol=0.05)
    for aspect in (0.6, 1.6):
        eye = first_view(people, frusta, axis, aspect)
        pose = eye.cam_from_world()
        seen = np.concatenate([people, frusta.reshape(-1, 3)]) @ pose[:3, :3].T + pose[:3, 3]
        half = np.tan(0.45)
        assert (seen[:, 2] > 0).all()
        assert (np.abs(seen[:, 0] / seen[:, 2]) < half * aspect).all()
        assert (np.abs(seen[:, 1] / seen[:, 2]) < half).all()
        body = people @ pose[:3, :3].T + pose[:3, 3]
        for corners in frusta @ pose[:3, :3].T + pose[:3, 3]:
            flat, person = corners[:, :2] / corners[:, 2:], body[:, :2] / body[:, 2:]
            apart = (flat.min(axis=0) > person.max(axis=0)).any() or (flat.max(axis=0) < person.min(axis=0)).any()
            assert apart or corners[:, 2].min() > body[:, 2].min()


def test_a_lost_limb_is_told_from_a_doubtful_one_and_a_doubtful_frame(world):
    _, motion = world
    skeleton = motion.character.skeleton
    of = {limb: skeleton.bodies_of(limb)[list(skeleton.landmark_bodies)] for limb in skeleton.limbs}
    confidence = np.ones((FRAMES, len(skeleton.landmark_names)))
    confidence[0, of["l_arm"]], confidence[0, of["r_leg"]] = 0, 0.2
    confidence[2] = 0
    lost = [{"part": "left arm", "first": 0, "last": 0, "why": "no view shows it"}]
    judged = replace(motion, confidence=confidence, provenance={**motion.provenance, "lost": lost})
    expected = np.full(len(skeleton.body_names), "ok", dtype="<U8")
    expected[skeleton.bodies_of("l_arm")], expected[skeleton.bodies_of("r_leg")] = "lost", "doubtful"
    assert body_status(judged, 0) == expected.tolist()
    assert set(body_status(judged, 1)) == {"doubtful"}  # as the frame is
    assert set(body_status(judged, 2)) == {"lost"}
    assert words_about(judged, 0) == "ok; left arm: no view shows it"
    picture = draw_scene(gather(judged), 0, first_view(*gather(judged).scene(0), 4 / 3))
    r, g, b = np.moveaxis(picture.astype(int), -1, 0)
    found = {"ok": b - r > 40, "doubtful": g - b > 40, "lost": (r - g > 30) & (np.abs(g - b) < 40)}
    counts = {name: int(where.sum()) for name, where in found.items()}
    assert min(counts["ok"], counts["doubtful"], counts["lost"]) > 30, counts


def test_a_movie_turns_once_round_and_a_picture_is_the_first_view(world, tmp_path, capsys, monkeypatch):
    _, motion = world
    monkeypatch.setattr(turntable, "_TURN", 0.3)
    motion.save(tmp_path / "result")
    turn = tmp_path / "a new folder" / "turn.mp4"
    assert run(["view", str(tmp_path / "result"), "--movie", str(turn)]) == 0
    with av.open(str(turn)) as movie:
        frames = [frame.to_ndarray(format="rgb24") for frame in movie.decode(video=0)]
    step = float(np.median(np.diff(motion.timestamps)))
    assert len(frames) == FRAMES * int(np.ceil(0.3 / (FRAMES * step)))
    first = gather(motion)
    seconds, shown, eyes = zip(*turntable.eyes(first), strict=True)
    assert shown == tuple(range(FRAMES)) * (len(frames) // FRAMES)
    flat = np.delete([eye.position - _target(first) for eye in eyes], 1, axis=1)
    angles = np.unwrap(np.arctan2(flat[:, 1], flat[:, 0])) - np.arctan2(flat[0, 1], flat[0, 0])
    np.testing.assert_allclose(angles, 2 * np.pi * np.array(seconds) / (len(frames) * step), atol=1e-6)
    assert run(["view", str(tmp_path / "result"), "--movie", str(tmp_path / "first.png")]) == 0
    picture = cv2.imread(str(tmp_path / "first.png"))
    assert picture.shape == (720, 960, 3)
    assert run(["view", str(tmp_path / "result"), "--movie", str(tmp_path / "first.png")]) == 2
    assert "exists already" in capsys.readouterr().err
    assert run(["view", str(tmp_path / "result"), "--movie", str(tmp_path / "first.gif")]) == 2
    assert ".mp4" in capsys.readouterr().err


@pytest.mark.parametrize("beside", [False, True])
def test_a_movie_never_cuts_the_body(beside):
    """Somebody runs past a clip's middle with their arms stretched out."""
    character, times = make_actor(), np.arange(24) / 10
    skeleton = character.skeleton
    root = np.tile(np.eye(4), (24, 1, 1))
    root[:, 0, 3], root[:, 1, 3] = 3 * (times - 1.2), 0.3 * np.sin(9 * times) ** 2
    angles = np.tile(-angles_at_rest(skeleton), (24, 1))
    poses = Pose(jnp.asarray(root, jnp.float32), jnp.asarray(angles, jnp.float32))
    motion = Motion.from_poses(character, poses, np.arange(24), times)
    shown = gather(motion, motion if beside else None)
    half = np.tan(FIELD_OF_VIEW / 2)
    room = []
    for _, index, eye in turntable.eyes(shown):
        pose, vertices = eye.cam_from_world(), motion.vertices(index)
        vertices = np.concatenate([vertices, vertices + shown.aside()]) if beside else vertices
        seen = vertices @ pose[:3, :3].T + pose[:3, 3]
        assert (seen[:, 2] > 0).all()
        room.append(1 - np.abs(seen[:, :2] / seen[:, 2:] / half / [4 / 3, 1]).max())
    assert len(room) == 72
    assert 0 < min(room) < 0.1  # not far away either


def _target(shown) -> np.ndarray:
    people, _, axis = shown.scene(0)
    return first_view(people, np.zeros((0, 5, 3)), axis, 4 / 3).target


def test_a_body_follows_the_slider_and_slow_images_wait_until_it_rests(viewer, monkeypatch):
    viewer.go(0)
    images, bodies = [], []
    monkeypatch.setattr(viewer._body, "draw", lambda index, *_: bodies.append(index))

    def slowly(index, *_):
        images.append(index)
        time.sleep(0.2)
        return {}

    monkeypatch.setattr(viewer._cameras, "read_images", slowly)
    for turn in range(1, 40):
        viewer._slider.value = turn % FRAMES
        time.sleep(0.01)
    begin = time.perf_counter()
    while not images or images[-1] != 39 % FRAMES:
        assert time.perf_counter() - begin < 5
        time.sleep(0.01)
    assert bodies[-1] == 39 % FRAMES
    assert len(images) < len(bodies) / 3  # images wait until the slider rests


def test_a_body_goes_on_while_the_images_of_an_earlier_place_are_decoded(viewer, monkeypatch):
    viewer.go(0)
    drawn, decoding = {}, threading.Event()
    monkeypatch.setattr(viewer._body, "draw", lambda index, *_: drawn.setdefault(index, time.perf_counter()))

    def slowly(*_):
        decoding.set()
        time.sleep(2)
        return {}

    monkeypatch.setattr(viewer._cameras, "read_images", slowly)
    viewer._slider.value = 1
    assert decoding.wait(5)
    moved = time.perf_counter()
    viewer._slider.value = 2
    while 2 not in drawn:
        assert time.perf_counter() - moved < 5
        time.sleep(0.01)
    assert drawn[2] - moved < 1  # not after the images of position 1
