"""Bare meshes of people become characters whose joints are where they are known to be."""

import json

import numpy as np
import pytest
import trimesh
from bodies import JOINTS, WORST, errors, small_person, standing, tall_person, turned_out, within_bounds
from scipy.spatial.transform import Rotation

from jaxmocap import Character, InputError, rig
from jaxmocap._cli import run
from jaxmocap.rigging import _bind, open_actor


@pytest.fixture(scope="module")
def relaxed():
    return standing(tall_person(), "relaxed")


@pytest.fixture(scope="module")
def coarse(relaxed):
    """The same of a quarter of the triangles, for what does not depend on them."""
    mesh = trimesh.Trimesh(*relaxed[:2], process=False)
    return mesh.simplify_quadric_decimation(face_count=len(mesh.faces) // 4)


@pytest.fixture(scope="module")
def rigged(relaxed):
    return rig(relaxed[:2])


@pytest.mark.slow
def test_a_relaxed_stance_in_metres(rigged, relaxed):
    within_bounds(rigged, relaxed[2])
    assert rigged.report["units"] == "m"
    assert (rigged.report["up"], rigged.report["front"]) == ("y", "z")
    assert rigged.report["height_m"] == pytest.approx(np.ptp(relaxed[0][:, 1]), abs=1e-3)
    assert rigged.report["repairs"] == []
    assert rigged.report["warnings"] == []
    assert rigged.report["closed"]


def test_weights_are_a_partition_over_four_bones_and_no_triangle_turns_out(rigged):
    weights = np.asarray(rigged.character.weights)
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-5)
    assert weights.min() >= 0
    assert np.count_nonzero(weights, axis=1).max() <= 4
    assert turned_out(rigged.character) <= 0.01
    assert rigged.report["turned_out"] == pytest.approx(turned_out(rigged.character), abs=1e-4)


@pytest.mark.slow
def test_blends_are_widened_where_the_skin_would_turn_inside_out_and_nowhere_else(rigged, relaxed, monkeypatch):
    monkeypatch.setattr(_bind, "_ROUNDS", 0)
    heat = rig(relaxed[:2])
    assert rigged.report["turned_out"] < 0.85 * heat.report["turned_out"]
    skeleton, vertices = rigged.character.skeleton, np.asarray(rigged.character.vertices)
    middle = 0.5 * (skeleton.landmark("l_knee") + skeleton.landmark("l_ankle"))
    shin = np.linalg.norm(vertices - np.asarray(middle), axis=1) < 0.08
    assert shin.sum() > 10
    np.testing.assert_allclose(rigged.character.weights[shin], heat.character.weights[shin], atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("num_faces", [1000, 12_000])
def test_meshes_of_few_and_of_many_triangles_do_not_turn_out(num_faces, relaxed):
    mesh = trimesh.Trimesh(*relaxed[:2], process=False)
    if num_faces > len(mesh.faces):
        mesh = mesh.subdivide()
    rigged = rig((np.asarray(mesh.vertices), np.asarray(mesh.faces)), num_faces=num_faces)
    assert turned_out(rigged.character) <= 0.01
    within_bounds(rigged, relaxed[2])


def test_the_hand_takes_over_linearly_along_the_forearm(rigged):
    """Where only forearm and hand hold the skin, the hand's share is the fraction of the way to the wrist."""
    skeleton, weights = rigged.character.skeleton, np.asarray(rigged.character.weights)
    for side in "lr":
        elbow, wrist = (np.asarray(skeleton.landmark(f"{side}_{joint}")) for joint in ("elbow", "wrist"))
        along = (np.asarray(rigged.character.vertices) - elbow) @ (wrist - elbow) / np.sum((wrist - elbow) ** 2)
        forearm, hand = (weights[:, skeleton.body_names.index(f"{side}_{body}")] for body in ("forearm", "hand"))
        ring = (forearm + hand > 0.999) & (along > 0.05) & (along < 0.95)
        assert ring.sum() > 20
        np.testing.assert_allclose(hand[ring], along[ring], atol=0.02)


def test_limits_contain_the_rest_pose_and_sides_mirror(rigged):
    skeleton = rigged.character.skeleton
    assert np.all(np.asarray(skeleton.lower) < 0)
    assert np.all(np.asarray(skeleton.upper) > 0)
    left, right = np.asarray(skeleton.landmark("l_wrist")), np.asarray(skeleton.landmark("r_wrist"))
    np.testing.assert_allclose(left * (-1, 1, 1), right, atol=0.03)
    assert left[0] > 0.1  # the subject's left


@pytest.mark.slow
def test_a_t_pose_turned_in_space_in_millimetres_with_noise():
    vertices, faces, joints = standing(small_person(), "T")
    turn = Rotation.from_euler("xyz", [40, 70, -130], degrees=True).as_matrix()
    there = lambda points: 1000 * np.asarray(points) @ turn.T + 400  # noqa: E731
    noise = np.random.default_rng(0).normal(scale=4.0, size=vertices.shape)
    rigged = rig((there(vertices) + noise, faces), units="mm")
    within_bounds(rigged, {joint: there(place) for joint, place in joints.items()})
    assert rigged.report["units"] == "mm"


@pytest.mark.slow
def test_a_mirrored_z_up_file_in_centimetres_with_holes_keeps_left_left():
    """The mirror image of a person is a person whose left is the other's right."""
    vertices, faces, joints = standing(small_person(), "A")
    z_up = 100 * np.array([[-1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # a reflection and a quarter turn
    kept = np.random.default_rng(1).random(len(faces)) > 0.2
    rigged = rig((vertices @ z_up.T, faces[kept]))
    swap = {"l": "r", "r": "l"}
    truth = {swap.get(j[0], j[0]) + j[1:] if j[1] == "_" else j: z_up @ place for j, place in joints.items()}
    within_bounds(rigged, truth)
    report = rigged.report
    assert (report["units"], report["up"], report["front"]) == ("cm", "z", "-y")
    assert any("holes" in repair for repair in report["repairs"])
    assert any("outwards" in repair for repair in report["repairs"])


@pytest.mark.slow
def test_joints_that_are_given_are_kept(relaxed):
    vertices, faces, joints = relaxed
    given = {"l_elbow": joints["l_elbow"] + [0.0, 0.0, 0.03], "neck": joints["neck"]}
    off = errors(rig((vertices, faces), joints=given), joints | given)
    assert off["l_elbow"] < 0.01
    assert off["neck"] < 0.01
    assert max(off.values()) < WORST


@pytest.mark.parametrize(
    ("mesh", "words"),
    [
        ("ball", "does not look like a standing person"),
        pytest.param("column", "where a standing person has it", marks=pytest.mark.slow),
        pytest.param("one-armed", "no left forearm", marks=pytest.mark.slow),
        ("handful", "usable triangles"),
    ],
)
def test_what_is_no_whole_person_is_refused_with_a_reason(mesh, words, relaxed):
    vertices, faces, joints = relaxed
    arm = (vertices[faces].mean(axis=1) - joints["l_shoulder"]) @ (joints["l_wrist"] - joints["l_shoulder"]) > 0.04
    lower_left = arm & (vertices[faces].mean(axis=1)[:, 0] > joints["l_shoulder"][0] + 0.02)
    ball, column = trimesh.creation.icosphere(3), trimesh.creation.cylinder(0.2, 1.7, sections=40).subdivide()
    shapes = {
        "ball": (ball.vertices, ball.faces),
        "column": (column.vertices, column.faces),
        "one-armed": (vertices, faces[~lower_left]),
        "handful": (vertices, faces[:50]),
    }
    with pytest.raises(InputError, match=words):
        rig(tuple(np.asarray(part) for part in shapes[mesh]))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"num_faces": 10}, "10 triangles were asked for"),
        ({"up": "w"}, "up is 'w'"),
        ({"joints": {"l_tail": [0, 0, 0]}}, "'l_tail' is no joint"),
        ({"joints": {"l_knee": [0, 0]}}, "three numbers"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, words, relaxed):
    with pytest.raises(InputError, match=words):
        rig(relaxed[:2], **options)


def test_from_a_file_to_a_character_by_the_command_line(tmp_path, capsys, relaxed, coarse):
    mesh = tmp_path / "scan.ply"
    trimesh.Trimesh(coarse.vertices * 39.37, coarse.faces, process=False).export(mesh)
    out, picture = tmp_path / "new" / "scan.glb", tmp_path / "scan.png"
    elbow = 39.37 * (relaxed[2]["l_elbow"] + [0.0, 0.0, 0.03])
    place = "l_elbow=" + ",".join(f"{number:.5f}" for number in elbow)
    help_given = ["--height", "1.8", "--joint", place]
    assert run(["rig", str(mesh), "--out", str(out), *help_given, "--picture", str(picture), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["height_m"] == pytest.approx(1.8)
    character = Character.load(out)
    assert float(np.ptp(np.asarray(character.vertices)[:, 1])) == pytest.approx(1.8, abs=1e-3)
    assert character.skeleton.num_dofs == 39
    heights = coarse.vertices[:, 1]
    from_floor = (elbow[1] / 39.37 - heights.min()) * 1.8 / np.ptp(heights)
    assert character.skeleton.landmark("l_elbow")[1] == pytest.approx(from_floor, abs=1e-3)
    assert picture.stat().st_size > 10_000
    assert run(["rig", str(mesh), "--out", str(out)]) == 2
    assert "exists already" in capsys.readouterr().err
    np.testing.assert_array_equal(np.asarray(open_actor(out).weights), np.asarray(character.weights))


@pytest.mark.parametrize("text", ["l_elbow", "l_elbow=1,x,2", "l_elbow=1,2", "l_tail=1,2,3"])
def test_single_joints_that_make_no_sense_are_refused(text, tmp_path, capsys, relaxed):
    mesh = tmp_path / "scan.ply"
    trimesh.Trimesh(*relaxed[:2], process=False).export(mesh)
    assert run(["rig", str(mesh), "--out", str(tmp_path / "him.glb"), "--joint", text]) == 2
    assert "expected" in (said := capsys.readouterr().err) or "is no joint" in said


def test_a_skin_that_the_file_brings_is_kept_and_simplified(tmp_path, capsys):
    own = tall_person().save_glb(tmp_path / "skinned.glb")
    assert run(["rig", str(own), "--out", str(tmp_path / "few.glb"), "--triangles", "2000", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["skin"] == "kept"
    assert abs(report["triangles"]["after"] - 2000) <= 2
    few = Character.load(tmp_path / "few.glb")
    np.testing.assert_allclose(few.skeleton.landmarks, tall_person().skeleton.landmarks, atol=1e-6)
    assert rig(own).rest_from_file is None
    with pytest.raises(InputError, match="which is kept"):
        rig(own, height=1.8)


def test_an_actor_without_a_skin_is_rigged_and_said_so(tmp_path, coarse):
    path, said = tmp_path / "actor.glb", []
    coarse.export(path)
    character = open_actor(path, said.append)
    assert character.name == "actor"
    assert character.weights.shape[1] == 18
    first, few = said
    assert "has no skeleton and was rigged" in first
    assert "about 5,000 track better" in few


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("absent.obj", None, "does not exist"),
        ("scan.txt", "v 0 0 0", "not a known kind of mesh"),
        ("points.obj", "v 0 0 0\nv 1 0 0\n", "no triangles|cannot be read"),
        ("broken.ply", "ply\nformat ascii 1.0\nelement vertex 3\nend_header\n", "cannot be read|no triangles"),
    ],
)
def test_files_that_hold_no_mesh_are_refused(name, content, words, tmp_path):
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=words):
        rig(tmp_path / name)


@pytest.mark.parametrize("capture", ["plaza", pytest.param("street", marks=pytest.mark.slow)])
def test_scans_of_the_captures_get_the_joints_of_their_skinned_twins(capture, data):
    truth = Character.load(data / capture / "actor.glb").skeleton
    for num_faces in (5000, 1000):
        rigged = rig(data / capture / "actor.obj", num_faces=num_faces)
        within_bounds(rigged, {joint: np.asarray(truth.landmark(joint)) for joint in JOINTS})
        assert turned_out(rigged.character) <= 0.01
