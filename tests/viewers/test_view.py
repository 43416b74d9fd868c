"""The viewer: what it shows at each frame, whom it lets in, and what it says about what is not there."""

import urllib.request
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxmocap._cli import run
from jaxmocap._results import InputError
from jaxmocap.camera import Cameras
from jaxmocap.motion import Motion
from jaxmocap.synthetic import make_capture, write_capture
from jaxmocap.viewers import view, write_rerun
from jaxmocap.viewers._shown import gather

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


def test_a_truth_in_another_world_is_brought_to_the_motions(world, tmp_path):
    shown, motion = world
    turn, shift = Rotation.from_rotvec([0.3, 1.0, -0.2]).as_matrix(), np.array([4.0, -1.0, 2.0])
    moved = np.asarray(shown.cameras.cam_from_world, np.float64).copy()
    moved[..., :3, :3] = moved[..., :3, :3] @ turn.T  # cam_from_truth = cam_from_world world_from_truth
    moved[..., :3, 3] -= moved[..., :3, :3] @ shift
    markers = shown.markers @ turn.T + shift
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


def test_every_frame_shows_its_pose_its_images_and_its_status(viewer, world):
    shown, motion = world
    for index in (2, 1, 3, 0):
        viewer.go(index)
        assert viewer._slider.value == index
        np.testing.assert_allclose(viewer._mesh.vertices, motion.vertices(index), atol=1e-5)
        np.testing.assert_allclose(viewer._truth.points, shown.markers[index], atol=2e-3)  # float16 on the wire
        assert viewer._says.value.endswith(str(motion.status[index]))
        ends = viewer._bones.points[0]
        pelvis, spine = (motion.joints[index, motion.joint_names.index(name)] for name in ("pelvis", "spine"))
        np.testing.assert_allclose(ends, [pelvis, spine], atol=1e-6)
        np.testing.assert_allclose(viewer._cameras.frusta[1].position, shown.cameras.centres()[1, index], atol=1e-4)
        assert viewer._other_mesh.visible == (index > 0)


def test_toggles_hide_what_they_name(viewer):
    viewer.go(1)
    pairs = {
        "_with_mesh": viewer._mesh,
        "_with_bones": viewer._bones,
        "_with_truth": viewer._truth,
        "_with_other": viewer._other_mesh,
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
    assert viewer._mesh.opacity == 0.5


def test_a_second_result_stands_to_the_right_when_side_by_side(viewer, world):
    shown, _ = world
    right = np.asarray(shown.cameras.cam_from_world[0, 0, 0, :3])
    for beside, expected in ((True, 1.5 * right), (False, np.zeros(3))):
        viewer._beside.value = beside
        viewer._redraw()
        np.testing.assert_allclose(viewer._other_mesh.position, expected, atol=1e-5)


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
    plot, _, _ = viewer._plots[0]
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


def test_a_recording_for_rerun_holds_every_frame(world, tmp_path):
    pytest.importorskip("rerun", reason="rerun-sdk, of the extra 'rerun', is not installed")
    _, motion = world
    path, missing = write_rerun(motion, tmp_path / "x.rrd", other=motion[1:])
    assert missing == ()
    content = path.read_bytes()
    assert content[:4] in (b"RRF2", b"RRF3")
    for entity in (b"world/result/mesh", b"world/second_result/skeleton", b"world/truth", b"world/cameras/cam1/image"):
        assert entity in content
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
