"""Registration at the selected frames, through files."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from perturbed import moved

from jaxmocap._results import InputError
from jaxmocap.character import landmark_positions, pose_vector, skin
from jaxmocap.energies import contour_lines
from jaxmocap.geometry import vertex_normals
from jaxmocap.observation import build_problem, draw, frame_rectangle, key_poses_of, mask_edges, surface_of
from jaxmocap.registration import RegistrationSettings, register
from jaxmocap.registration._fit_silhouette import mask_contours

LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle", "heel", "toe")
BODY = ("pelvis", "spine", "thorax", "neck", *(f"{side}_{joint}" for side in "lr" for joint in LIMBS))


@pytest.fixture(scope="module")
def registered(world):
    return register(world.capture, world.cameras, world.character, key=jax.random.key(1))


def errors(world, frame, pose, names):
    skeleton = world.character.skeleton
    wanted = [skeleton.landmark_names.index(name) for name in names]
    return np.linalg.norm(np.asarray(landmark_positions(skeleton, pose)) - world.truth.joints[frame], axis=1)[wanted]


def test_landmarks_are_found_to_two_centimetres_at_the_selected_frames(world, registered):
    assert sorted(registered) == list(world.truth.selected_frames)
    for frame, found in registered.items():
        assert found.frame == frame
        distance = errors(world, frame, found.pose, BODY)
        assert distance.mean() < 0.008, frame
        assert distance.max() < 0.05, frame


def test_silhouettes_agree_and_the_report_says_so(world, registered):
    for found in registered.values():
        assert found.iou.shape == (2,)
        assert np.all(found.iou > 0.93)
        assert not found.searched
        assert 0 < found.keypoint_rms < 0.05
    assert all(key_poses_of(registered)[frame] is found.pose for frame, found in registered.items())


def test_the_head_keeps_looking_where_the_nose_was_seen(world, registered):
    for frame, found in registered.items():
        assert errors(world, frame, found.pose, ["nose"]) < 0.05, frame


def test_joint_limits_hold(world, registered):
    skeleton = world.character.skeleton
    for found in registered.values():
        assert np.all((found.pose.angles >= skeleton.lower - 1e-5) & (found.pose.angles <= skeleton.upper + 1e-5))


QUICK = RegistrationSettings(rounds=2, view_flow=0)


def test_the_distance_to_the_keypoints_is_that_of_the_pose_in_the_end(world, registered):
    """A start that is far off comes to the keypoints, and they count though no inverse kinematics asked for them."""
    start = moved(world, 0, root_tx=0.05)
    found = register(world.capture, world.cameras, world.character, (0,), start=start)[0]
    assert found.keypoint_rms == pytest.approx(registered[0].keypoint_rms, abs=0.003)


@pytest.mark.slow
def test_frames_side_by_side_come_out_as_each_alone_and_progress_is_told(world):
    told = []
    both = register(
        world.capture,
        world.cameras,
        world.character,
        settings=QUICK,
        progress=lambda stage, done, total: told.append((stage, done, total)),
    )
    assert told == [("register", 0, 2), ("register", 1, 2), ("register", 2, 2)]
    for frame, found in both.items():
        alone = register(world.capture, world.cameras, world.character, (frame,), settings=QUICK)[frame]
        for one, other in zip(jax.tree.leaves(found.pose), jax.tree.leaves(alone.pose), strict=True):
            assert np.asarray(one).tobytes() == np.asarray(other).tobytes()


def test_overrides_stay_as_they_were_given(world):
    values = {"root_ty": float(pose_vector(world.character.skeleton, world.pose(0))[1]), "l_elbow_flex": 42.0}
    found = register(
        world.capture, world.cameras, world.character, (0,), start=world.pose(0), overrides={0: values}, settings=QUICK
    )
    vector = np.asarray(pose_vector(world.character.skeleton, found[0].pose))
    names = world.character.skeleton.dof_names
    np.testing.assert_allclose(vector[names.index("root_ty")], values["root_ty"], atol=1e-4)
    np.testing.assert_allclose(vector[names.index("l_elbow_flex")], np.deg2rad(42), atol=1e-4)


def test_a_given_start_needs_no_keypoints(world):
    found = register(world.capture, world.cameras, world.character, (2,), start=world.pose(2), settings=QUICK)
    assert list(found) == [2]
    assert np.isnan(found[2].keypoint_rms)
    assert np.all(np.isnan(found[2].iou))  # no masks at this frame


def test_a_frame_without_keypoints_or_pose_is_refused_in_a_sentence(world):
    sentence = r"frame 2 of capture 'synthetic' has no keypoints and no initial pose; .*cam0_00002_keypoints\.json"
    with pytest.raises(InputError, match=sentence):
        register(world.capture, world.cameras, world.character, (2,))


def test_a_person_behind_the_camera_is_refused_in_a_sentence(world):
    behind = eqx.tree_at(lambda p: p.root, world.pose(0), world.pose(0).root.at[:3, 3].add(jnp.array([0, 0, 30.0])))
    with pytest.raises(InputError, match=r"the person lies behind camera 'cam[01]' at frame 0"):
        register(world.capture, world.cameras, world.character, (0,), start=behind, settings=QUICK)


def test_mirrored_cameras_are_refused_in_a_sentence(world):
    turned = jnp.array([-1.0, 1.0, 1.0, 1.0])
    poses = turned[:, None] * world.cameras.cam_from_world * turned
    mirrored = eqx.tree_at(lambda c: c.cam_from_world, world.cameras, poses)
    with pytest.raises(InputError, match=r"capture 'synthetic': .* point backwards: the cameras are mirrored"):
        register(world.capture, mirrored, world.character, (0,), settings=QUICK)


def test_outlines_of_masks_ask_for_no_growth_at_the_true_pose(world):
    """Less than a tenth of a pixel; it was a quarter, inwards or outwards."""
    character, pose = world.character, world.pose(0)
    vertices = np.asarray(skin(character, pose))
    surface = surface_of(character, None, world.cameras.num_cameras)
    rectangle = frame_rectangle(vertices, world.cameras, 0, speed=np.full(2, 30.0))
    images = [world.capture.image(camera, 0) for camera in range(2)]
    edges = [mask_edges(rectangle.crop(world.capture.mask(camera, 0), camera)) for camera in range(2)]
    problem = build_problem(images, rectangle, world.cameras, 0, vertices, surface, edges=edges)
    posed, ids, inverse_depth = draw(character, pose, problem)
    lines = contour_lines(posed, character.faces, ids, inverse_depth, problem, mask_contours(12))
    normals = vertex_normals(vertices, np.asarray(character.faces))[np.asarray(lines.corners)]
    outward = np.cross(np.einsum("rk,rkc->rc", np.asarray(lines.barycentric), normals), np.asarray(lines.direction))
    weighted = np.asarray(lines.weight)[:, None] * outward
    growth = -(weighted * np.asarray(lines.residual(posed))).sum() / (weighted * outward).sum()
    view = world.cameras.at(0)
    depth = (np.asarray(view.cam_from_world)[:, 2] @ np.append(vertices.mean(0), 1)).mean()
    pixel = depth / float(np.asarray(view.intrinsics)[:, 0, 0].mean())
    assert np.asarray(lines.weight).sum() > 300
    assert abs(growth) < 0.1 * pixel
