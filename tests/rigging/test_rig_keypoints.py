"""A detector's keypoints in pictures of a mesh help to rig it; the detector is the truth with some noise."""

import json
import shutil

import cv2
import numpy as np
import pytest
import trimesh
from bodies import JOINTS, errors, standing, tall_person, within_bounds, write_keypoints, write_people
from scipy.spatial.transform import Rotation

from jaxmocap import Character, InputError, read_cameras, rig, rig_pictures
from jaxmocap._cli import run
from jaxmocap.detection import read_people
from jaxmocap.rigging._keypoints import _person
from jaxmocap.rigging._seen_joints import cross

VIEWS = ("front", "front_left", "front_right")


@pytest.fixture(scope="module")
def one_arm_up():
    return standing(tall_person(), "one arm up")


@pytest.fixture(scope="module")
def seen(one_arm_up, tmp_path_factory):
    """A folder of pictures of it, with keypoints."""
    folder = tmp_path_factory.mktemp("seen") / "pictures"
    write_keypoints(folder, rig_pictures(one_arm_up[:2], folder), one_arm_up[2])
    return folder


@pytest.fixture
def copied(seen, tmp_path):
    return shutil.copytree(seen, tmp_path / "copied")


def test_pictures_show_the_mesh_where_its_cameras_see_it(one_arm_up, seen):
    cameras = read_cameras(seen / "cameras.toml", VIEWS, 1)
    for camera, name in enumerate(VIEWS):
        image = cv2.imread(str(seen / f"{name}.png"))
        assert image.shape[1::-1] == cameras.sizes[camera]
        person = np.abs(image.astype(int) - image[0, 0]).max(axis=2) > 8
        rows = np.flatnonzero(person.any(axis=1))
        assert np.ptp(rows) > 0.7 * image.shape[0]
        (points,) = read_people(seen / f"{name}_keypoints.json")
        columns, rows = np.floor(points[points[:, 2] > 0, :2]).astype(int).T
        assert person[rows, columns].mean() > 0.9


def test_mediapipe_s_shares_are_of_the_picture(tmp_path):
    shares = [{"x": 0.25, "y": 0.5, "visibility": 0.9}] * 33
    (tmp_path / "front_keypoints.json").write_text(json.dumps({"pose_landmarks": [shares]}))
    np.testing.assert_allclose(_person(tmp_path / "front_keypoints.json", (400, 900))[4], [100, 450, 0.9])


@pytest.mark.slow
def test_a_body_that_is_refused_without_keypoints_is_rigged_with_them(one_arm_up, seen, tmp_path):
    vertices, faces, joints = one_arm_up
    with pytest.raises(InputError, match="no left upper arm"):
        rig((vertices, faces))
    rigged = rig((vertices, faces), keypoints=seen)
    within_bounds(rigged, joints)
    assert rigged.report["keypoints"]["pictures"] == list(VIEWS)
    assert np.median(list(rigged.report["keypoints"]["off_cm"].values())) < 3
    within_bounds(rig((vertices, faces), keypoints=seen / "front_keypoints.json"), joints)


@pytest.mark.slow
def test_joints_given_by_hand_overrule_keypoints(one_arm_up, seen):
    vertices, faces, joints = one_arm_up
    given = {"l_elbow": joints["l_elbow"] + [0.0, 0.0, 0.03]}
    rigged = rig((vertices, faces), joints=given, keypoints=seen)
    assert errors(rigged, given)["l_elbow"] < 0.01


@pytest.mark.slow
def test_keypoints_tell_the_front_of_pictures_from_behind_of_a_mesh_in_millimetres(one_arm_up, tmp_path):
    """The pictures are drawn from behind, and in one of them the detector takes left for right."""
    vertices, faces, joints = one_arm_up
    turn = Rotation.from_euler("xyz", [90, 0, 30], degrees=True).as_matrix()
    there = lambda points: 1000 * np.asarray(points) @ turn.T + 400  # noqa: E731
    mesh, truth = (there(vertices), faces), {joint: there(place) for joint, place in joints.items()}
    cameras = rig_pictures(mesh, tmp_path / "behind", up="z", front="y")
    write_keypoints(tmp_path / "behind", cameras, truth, exchanged=("front_right",))
    rigged = rig(mesh, units="mm", keypoints=tmp_path / "behind")
    within_bounds(rigged, truth)
    assert rigged.report["up"] == "z"
    forward = rigged.rest_from_file[2, :3] / np.linalg.norm(rigged.rest_from_file[2, :3])
    np.testing.assert_allclose(forward, turn @ [0, 0, 1], atol=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("views", [VIEWS, ("front",)])
def test_a_scan_keeps_or_betters_its_joints(views, data, tmp_path):
    truth = Character.load(data / "plaza" / "actor.glb").skeleton
    joints = {joint: np.asarray(truth.landmark(joint), float) for joint in JOINTS}
    scan = data / "plaza" / "actor.obj"
    write_keypoints(tmp_path / "scan", rig_pictures(scan, tmp_path / "scan"), joints)
    for name in set(VIEWS) - set(views):
        (tmp_path / "scan" / f"{name}_keypoints.json").unlink()
    with_them, without = (rig(scan, keypoints=folder) for folder in (tmp_path / "scan", None))
    within_bounds(with_them, joints)
    means = [np.mean(list(errors(rigged, joints).values())) for rigged in (with_them, without)]
    assert means[0] < means[1] + 0.1


@pytest.mark.slow
def test_by_the_command_line(one_arm_up, tmp_path, capsys):
    mesh, folder, out = tmp_path / "scan.ply", tmp_path / "pictures", tmp_path / "him.glb"
    trimesh.Trimesh(*one_arm_up[:2], process=False).export(mesh)
    assert run(["rig", str(mesh), "--pictures", str(folder), "--json"]) == 0
    drawn = json.loads(capsys.readouterr().out)
    assert drawn["files"] == [f"{name}.png" for name in VIEWS]
    assert run(["rig", str(mesh), "--pictures", str(folder)]) == 2
    assert "exists already" in capsys.readouterr().err
    write_keypoints(folder, read_cameras(folder / "cameras.toml", VIEWS, 1), one_arm_up[2])
    assert run(["rig", str(mesh), "--out", str(out), "--keypoints", str(folder)]) == 0
    assert "keypoints" in capsys.readouterr().out
    assert Character.load(out).skeleton.num_dofs == 39
    assert run(["rig", str(mesh), "--keypoints", str(folder)]) == 2
    assert "--out FILE.glb is needed" in capsys.readouterr().err


def spoil_points(change):
    def spoil(folder):
        for name in VIEWS:
            (points,) = read_people(folder / f"{name}_keypoints.json")
            write_people(folder / f"{name}_keypoints.json", change(points))

    return spoil


def only_the_left_arm(points):
    points[[n for n in range(25) if n not in (5, 6, 7)], 2] = 0
    return points


def without_files(folder):
    for name in VIEWS:
        (folder / f"{name}_keypoints.json").unlink()


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (shutil.rmtree, "does not exist"),
        (without_files, "holds no keypoints"),
        (lambda folder: (folder / "cameras.toml").unlink(), "cameras.toml does not exist"),
        (lambda folder: (folder / "cameras.toml").write_text("[cam"), "as --pictures wrote it"),
        (spoil_points(lambda points: points * [1.6, 1.6, 1]), "outside front.png of 900x1200 pixels"),
        (spoil_points(lambda points: points * [0.4, 0.4, 1]), "joints beside the person"),
        (spoil_points(lambda points: points * [np.nan, 1, 1]), "not finite"),
        (spoil_points(lambda points: points * 0), "found nobody in front.png"),
        (spoil_points(only_the_left_arm), "shows 3 joints"),
        (spoil_points(lambda points: points[:18]), "looks like COCO"),
        (lambda folder: (folder / "front_keypoints.json").write_text("{"), "is not JSON"),
    ],
)
def test_what_does_not_belong_to_the_mesh_is_refused_in_one_sentence(spoil, words, copied, one_arm_up):
    spoil(copied)
    with pytest.raises(InputError, match=words) as refused:
        rig(one_arm_up[:2], keypoints=copied)
    assert str(refused.value).endswith(".")


def test_a_ray_ends_in_the_middle_of_the_first_limb_it_passes():
    limbs = [trimesh.creation.cylinder(0.1, 2.0, sections=64).apply_translation([0, y, 0]) for y in (0.0, 0.5)]
    mesh = trimesh.util.concatenate(limbs).subdivide_to_size(0.05)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    through, beside = (cross(vertices, faces, np.array([x, -3.0, 0.2]), np.eye(3)[1]) for x in (0.03, 0.15))
    np.testing.assert_allclose(through.middle, [0.03, 0, 0.2], atol=2e-3)
    assert through.miss == 0
    assert beside.miss == pytest.approx(0.05, abs=0.01)
