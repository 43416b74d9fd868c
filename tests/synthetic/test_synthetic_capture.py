import cv2
import jax
import numpy as np
import pytest

from jaxmocap._results import InputError
from jaxmocap.camera import project
from jaxmocap.capture import Capture
from jaxmocap.character import Character, landmark_positions, skin
from jaxmocap.synthetic import _write, make_capture, make_scene, write_capture
from jaxmocap.synthetic._actor import _template, marker_positions
from jaxmocap.synthetic._raster import visible_fragments

ARRAYS = ("images", "masks", "markers", "joints", "keypoints", "timestamps")


def test_the_same_arguments_give_the_same_bytes(small_capture):
    again = make_capture(3, (192, 108), seed=1)
    for name in ARRAYS:
        assert getattr(again, name).tobytes() == getattr(small_capture, name).tobytes(), name
    assert (
        np.asarray(again.cameras.cam_from_world).tobytes() == np.asarray(small_capture.cameras.cam_from_world).tobytes()
    )


def test_the_same_capture_is_written_to_the_same_bytes(small_capture, tmp_path):
    folders = [write_capture(small_capture, tmp_path / name) for name in ("first", "second", "third")]
    files = [{file.name: file.read_bytes() for file in folder.rglob("*") if file.is_file()} for folder in folders]
    assert files[0] == files[1] == files[2]


def test_the_scene_and_the_skin_are_rebuilt_the_same():
    for a, b in zip(make_scene(1).panels, make_scene.__wrapped__(1).panels, strict=True):
        assert a.pyramid.atlas.tobytes() == b.pyramid.atlas.tobytes()
    for a, b in zip(_template(), _template.__wrapped__(), strict=True):
        assert a.tobytes() == b.tobytes()


def test_another_seed_gives_another_capture(small_capture):
    other = make_capture(3, (192, 108), seed=2, supersampling=1)
    assert np.any(other.images[0] != small_capture.images[0])
    assert np.any(other.keypoints[0] != small_capture.keypoints[0])


def test_shapes_follow_the_arguments(small_capture):
    assert small_capture.images.shape == (3, 2, 108, 192, 3)
    assert small_capture.masks.shape == (3, 2, 108, 192)
    assert small_capture.markers.shape == (3, 44, 3)
    assert small_capture.cameras.num_frames == 3
    assert small_capture.selected_frames == (0, 1)
    np.testing.assert_allclose(small_capture.timestamps, [0, 1 / 30, 2 / 30])


def test_markers_and_joints_are_those_of_the_true_pose(small_capture):
    character, pose = small_capture.character, small_capture.pose(2)
    vertices = np.asarray(jax.jit(skin)(character, pose), float)
    corners = vertices[np.asarray(character.faces)[small_capture.marker_faces]]
    expected = (small_capture.marker_barycentrics[:, :, None] * corners).sum(axis=1)
    np.testing.assert_allclose(small_capture.markers[2], expected, atol=2e-6)
    joints = jax.jit(landmark_positions)(character.skeleton, pose)
    np.testing.assert_allclose(small_capture.joints[2], np.asarray(joints), atol=2e-6)


def test_markers_are_spread_over_the_whole_body(small_capture):
    rest = marker_positions(
        np.asarray(small_capture.character.vertices)[None],
        np.asarray(small_capture.character.faces),
        small_capture.marker_faces,
        small_capture.marker_barycentrics,
    )[0]
    gaps = np.linalg.norm(rest[:, None] - rest[None], axis=-1) + 9 * np.eye(44)
    assert gaps.min() > 0.08
    assert np.ptp(rest[:, 1]) > 1.5


def test_visible_markers_project_onto_the_mask(small_capture):
    seen = 0
    for frame in (0, 2):
        view = small_capture.cameras.at(frame)
        pixels, depth = (
            np.asarray(v) for v in project(view.intrinsics, view.cam_from_world, small_capture.markers[frame])
        )
        vertices = np.asarray(jax.jit(skin)(small_capture.character, small_capture.pose(frame)), float)
        for camera in range(2):
            pose = np.asarray(view.cam_from_world[camera], float)
            points = vertices @ pose[:3, :3].T + pose[:3, 3]
            faces = np.asarray(small_capture.character.faces)
            fragments = visible_fragments(points, faces, np.asarray(view.intrinsics[camera], float), small_capture.size)
            nearest = np.zeros(192 * 108)
            nearest[fragments.index] = fragments.inverse_depth
            mask = small_capture.masks[frame, camera]
            np.testing.assert_array_equal(mask.reshape(-1), nearest > 0)
            near_mask = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3))) > 0
            columns, rows = np.floor(pixels[camera]).astype(int).T
            assert np.all(near_mask[rows, columns])
            visible = np.abs(1 / np.maximum(nearest.reshape(108, 192)[rows, columns], 1e-3) - depth[camera]) < 0.02
            seen += int((visible & mask[rows, columns]).sum())
    assert seen > 60


def test_keypoints_lie_around_the_projected_landmarks_with_the_stated_noise(small_capture):
    capture = make_capture(1, (192, 108), seed=1, keypoint_noise=25.0, supersampling=1)
    view = capture.cameras.at(0)
    names = capture.joint_names
    places = [names.index(name) for name in ("l_elbow", "r_knee", "l_heel")]
    pixels = np.asarray(project(view.intrinsics, view.cam_from_world, capture.joints[0])[0])[:, places]
    clean = make_capture(1, (192, 108), seed=1, keypoint_noise=0.0, supersampling=1).keypoints[0]
    np.testing.assert_allclose(clean[:, [6, 10, 21], :2], pixels, atol=1e-2)
    error = (capture.keypoints[0] - clean)[..., :2]
    assert error.std() == pytest.approx(25 * 192 / 960, rel=0.3)
    np.testing.assert_array_equal(capture.keypoints[..., 2], 1)


def test_illumination_change_scales_the_light(small_capture):
    steady = make_capture(4, (96, 54), seed=1, sensor_noise=0.0, supersampling=1)
    changing = make_capture(4, (96, 54), seed=1, sensor_noise=0.0, supersampling=1, illumination_change=-0.4)
    np.testing.assert_array_equal(changing.images[0], steady.images[0])
    middle = (steady.images[1] > 20) & (steady.images[1] < 250)
    ratio = changing.images[1][middle] / steady.images[1][middle].astype(float)
    assert np.median(ratio) == pytest.approx(np.sqrt(0.6), abs=0.01)


def test_motion_blur_changes_the_moving_actor_and_keeps_the_mask():
    arguments = {"sensor_noise": 0.0, "supersampling": 1, "camera_shake": 0.0, "seed": 1}
    sharp = make_capture(2, (192, 108), **arguments)
    blurred = make_capture(2, (192, 108), sub_frames=2, **arguments)
    np.testing.assert_array_equal(sharp.masks, blurred.masks)
    difference = np.abs(sharp.images.astype(int) - blurred.images).max(axis=-1)
    around = np.stack([[cv2.dilate(m.astype(np.uint8), np.ones((7, 7))) > 0 for m in frame] for frame in sharp.masks])
    assert difference[around].mean() > 2 * difference[~around].mean()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_frames": 0}, "num_frames"),
        ({"size": (191, 108)}, "even"),
        ({"num_cameras": 9}, "num_cameras"),
        ({"sub_frames": 0}, "sub_frames"),
        ({"selected_frames": (99,)}, "selected_frames"),
    ],
)
def test_arguments_out_of_range_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        make_capture(**({"num_frames": 2, "seed": 1, "size": (96, 54)} | arguments))


@pytest.fixture(scope="module")
def written(small_capture, tmp_path_factory):
    return write_capture(small_capture, tmp_path_factory.mktemp("synthetic") / "new" / "capture")


def test_a_written_capture_opens_with_the_same_times_and_cameras(small_capture, written):
    capture = Capture.open(written)
    assert (capture.num_frames, capture.fps, capture.sizes) == (3, 30.0, ((192, 108), (192, 108)))
    assert capture.findings == ()
    assert capture.selected_frames == small_capture.selected_frames
    np.testing.assert_allclose(capture.timestamps, small_capture.timestamps, atol=1e-4)
    np.testing.assert_allclose(capture.cameras.cam_from_world, small_capture.cameras.cam_from_world, atol=1e-6)
    np.testing.assert_allclose(capture.cameras.intrinsics, small_capture.cameras.intrinsics, atol=1e-4)


def test_written_videos_decode_to_within_a_few_grey_levels(small_capture, written):
    for frame, images in Capture.open(written).frames():
        for camera, image in enumerate(images):
            error = image.astype(float) - small_capture.images[frame, camera]
            assert np.abs(error).mean() < 6
            blocks = error.reshape(27, 4, 48, 4, 3).mean(axis=(1, 3))
            assert np.abs(blocks).mean() < 3
            assert np.abs(error.mean(axis=(0, 1))).max() < 1.5


def test_written_masks_and_keypoints_are_those_of_the_selected_frames(small_capture, written):
    capture = Capture.open(written)
    for row, frame in enumerate((0, 1)):
        for camera in range(2):
            np.testing.assert_array_equal(capture.mask(camera, frame), small_capture.masks[frame, camera])
            np.testing.assert_allclose(
                capture.keypoints(camera, frame), small_capture.keypoints[row, camera], atol=1e-3
            )
    assert capture.mask(0, 2) is None
    assert capture.keypoints(0, 2) is None


def test_the_written_actor_is_read_back_the_same(small_capture, written):
    character = Character.load(Capture.open(written).actor)
    np.testing.assert_allclose(character.vertices, small_capture.character.vertices, atol=1e-6)
    np.testing.assert_allclose(character.weights, small_capture.character.weights, atol=1e-6)
    np.testing.assert_allclose(character.skeleton.axes, small_capture.character.skeleton.axes, atol=1e-4)
    np.testing.assert_allclose(character.skeleton.landmarks, small_capture.character.skeleton.landmarks, atol=1e-5)


def test_the_written_truth_holds_markers_joints_and_poses(small_capture, written):
    with np.load(Capture.open(written).truth) as truth:
        np.testing.assert_array_equal(truth["markers"], small_capture.markers)
        np.testing.assert_array_equal(truth["joints"], small_capture.joints)
        assert tuple(truth["joint_names"]) == small_capture.joint_names
        assert truth["fps"] == 30
        np.testing.assert_array_equal(truth["root"], np.asarray(small_capture.poses.root))
        np.testing.assert_allclose(truth["pose"][:, 6:], np.asarray(small_capture.poses.angles), atol=1e-6)
        assert "cam_from_world" not in truth.files


def test_an_existing_capture_is_not_overwritten(small_capture, written):
    with pytest.raises(FileExistsError, match="capture"):
        write_capture(small_capture, written)


def test_a_failed_write_leaves_nothing_behind(small_capture, tmp_path, monkeypatch):
    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr(_write, "write_colmap_text", fail)
    with pytest.raises(OSError, match="disk full"):
        write_capture(small_capture, tmp_path / "capture")
    assert list(tmp_path.iterdir()) == []


def test_a_bystander_walks_past_behind_the_actor_and_is_no_part_of_the_truth():
    arguments = {"sensor_noise": 0.0, "supersampling": 1, "camera_shake": 0.0, "seed": 1, "fps": 5.0}
    alone = make_capture(4, (192, 108), **arguments)
    passed = make_capture(4, (192, 108), bystander=True, **arguments)
    np.testing.assert_array_equal(alone.masks, passed.masks)
    np.testing.assert_array_equal(alone.joints, passed.joints)
    changed = np.abs(alone.images.astype(int) - passed.images).max(axis=-1) > 20
    actor = np.stack([[cv2.dilate(m.astype(np.uint8), np.ones((5, 5))) > 0 for m in frame] for frame in alone.masks])
    upper = np.arange(108)[:, None] < 54  # above where anybody's shadow falls
    assert not (changed & alone.masks & upper).any()
    others = changed & ~actor
    assert others.mean(axis=(2, 3)).min() > 0.005
    columns = np.arange(192)
    middles = np.array([columns[frame[0].any(axis=0)].mean() for frame in others & upper])
    assert np.abs(np.diff(middles)).min() > 2  # pixels per frame
    assert len(set(np.sign(np.diff(middles)))) == 1


def test_the_lens_and_how_much_the_actor_fills_are_chosen():
    shown = make_capture(1, (192, 108), seed=1, focal_per_width=1.4, body_fraction=0.5, supersampling=1)
    assert float(shown.cameras.intrinsics[0, 0, 0]) == pytest.approx(1.4 * 192)
    rows = np.flatnonzero(shown.masks[0, 0].any(axis=1))
    assert np.ptp(rows) / 108 == pytest.approx(0.5, abs=0.05)
    points = shown.keypoints[0, 0, [10, 13], 1]  # knees
    assert np.all((points > rows.min()) & (points < rows.max()))
