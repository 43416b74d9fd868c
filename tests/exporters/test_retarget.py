"""Motions on rigs of other people: directions, path, feet that stand, names, and what is refused."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import bvhsdk
import jax.numpy as jnp
import numpy as np
import pytest
from humanoid_glb import MIXAMO, ROCKETBOX, UNREAL, Humanoid, pack, unpack, write_glb
from posed_glb import PosedGlb
from rigs_of_others import named, renamed, stranger
from scipy.spatial.transform import Rotation

from jaxmocap._cli import run
from jaxmocap._results import InputError
from jaxmocap.character import BODIES, Character, angles_at_rest
from jaxmocap.exporters import EXPORTERS, export
from jaxmocap.motion import Motion, turned
from jaxmocap.synthetic import dance, make_actor

TIMES = np.arange(45) / 30
LOOK = range(0, 45, 4)
BONES = [("upper_arm", "forearm"), ("forearm", "hand"), ("thigh", "shank"), ("shank", "foot")]
JOINT_OF = {body: joint for body, _, joint in BODIES}


@pytest.fixture(scope="module")
def source() -> Motion:
    """A dance of the synthetic actor, who rests in an A-pose."""
    actor = make_actor()
    return Motion.from_poses(actor, dance(actor.skeleton, TIMES + 1.0), np.arange(45) + 7, TIMES + 0.5)


@pytest.fixture(scope="module")
def airborne(source) -> Motion:
    return replace(source, provenance={"contacts": []}, root=lifted(source.root, 1.0), joints=source.joints + [0, 1, 0])


@pytest.fixture(scope="module")
def standing() -> Motion:
    """The left foot stays where it is while the knees bend and the rest of the body dances about it."""
    actor = make_actor()
    poses = dance(actor.skeleton, TIMES + 1.0)
    angles, bend = np.array(poses.angles), 0.5 - 0.5 * np.cos(2 * np.pi * TIMES)
    for name, most in (("hip_flex", 55), ("knee_flex", 90), ("ankle_dorsi", 25)):
        number = [actor.skeleton.angle_names.index(f"{side}_{name}") for side in "lr"]
        angles[:, number] = np.radians(most) * bend[:, None] - angles_at_rest(actor.skeleton)[number]
    moving = Motion.from_poses(actor, replace_angles(poses, angles), np.arange(45), TIMES)
    foot = moving.body_transforms[:, actor.skeleton.body_names.index("l_foot")].astype(float)
    held = np.linalg.inv(foot) @ moving.root
    contacts = [{"landmark": f"l_{point}", "first": 6, "last": 38} for point in ("heel", "toe")]
    poses = replace_root(replace_angles(poses, angles), held)
    return Motion.from_poses(actor, poses, np.arange(45), TIMES, provenance={"contacts": contacts})


def replace_angles(poses, angles):
    return type(poses)(poses.root, jnp.asarray(angles, jnp.float32))


def replace_root(poses, root):
    return type(poses)(jnp.asarray(root, jnp.float32), poses.angles)


def lifted(root: np.ndarray, height: float) -> np.ndarray:
    moved = root.copy()
    moved[:, 1, 3] += height
    return moved


def place(motion: Motion, frame: int, body: str) -> np.ndarray:
    return motion.joints[frame, motion.joint_names.index(JOINT_OF[body])]


def off(opened: PosedGlb, motion: Motion, frame: int, scheme: dict[str, str] = MIXAMO) -> dict[str, float]:
    """Degrees between the directions of limb bones."""
    opened.at(motion.timestamps[frame])
    found = {}
    for side in "lr":
        for upper, lower in BONES:
            bone = opened.place(named(f"{side}_{lower}", scheme)) - opened.place(named(f"{side}_{upper}", scheme))
            ours = place(motion, frame, f"{side}_{lower}") - place(motion, frame, f"{side}_{upper}")
            sine = np.linalg.norm(np.cross(bone, ours)) / np.linalg.norm(bone) / np.linalg.norm(ours)
            found[f"{side}_{upper}"] = float(np.degrees(np.arcsin(sine))) if bone @ ours > 0 else 180.0
    return found


def test_the_same_body_under_other_names_moves_as_ours(source, tmp_path):
    said = []
    rig = renamed(source.character, tmp_path / "same.glb")
    opened = PosedGlb(export(source, tmp_path / "out.glb", rig=rig, say=said.append))
    np.testing.assert_allclose(opened.times, source.timestamps, atol=1e-6)
    for frame in LOOK:
        opened.at(source.timestamps[frame])
        for body in JOINT_OF:
            np.testing.assert_allclose(opened.place(named(body)), place(source, frame, body), atol=1e-5)
        np.testing.assert_allclose(opened.vertices, source.vertices(frame), atol=1e-4)
    assert "out.glb: the path is scaled by 1.00, as the legs of same.glb are; planted feet slide by up to" in said[0]
    note = opened.animation.extras["jaxmocap"]
    assert (note["rig"], note["mesh_off_by"]) == ("same.glb", None)


@pytest.mark.parametrize("scale", [0.8, 1.25])
def test_a_body_of_another_size_keeps_all_directions_and_its_path_is_scaled(airborne, tmp_path, scale):
    actor = make_actor(scale * float(np.ptp(np.asarray(airborne.character.vertices)[:, 1])))
    scale = float(np.ptp(np.asarray(actor.vertices)[:, 1]) / np.ptp(np.asarray(airborne.character.vertices)[:, 1]))
    rig = renamed(actor, tmp_path / "size.glb")
    opened = PosedGlb(export(airborne, tmp_path / "out.glb", rig=rig))
    first = opened.at(airborne.timestamps[0]).place(named("pelvis"))
    for frame in LOOK:
        assert max(off(opened, airborne, frame).values()) < 0.05
        for body in JOINT_OF:
            expected = first + scale * (place(airborne, frame, body) - place(airborne, 0, "pelvis"))
            np.testing.assert_allclose(opened.place(named(body)), expected, atol=5e-4)


@pytest.mark.parametrize("scheme", [MIXAMO, UNREAL], ids=["mixamo", "unreal"])
def test_limbs_of_other_proportions_in_a_t_pose_point_as_ours(airborne, tmp_path, scheme):
    rig = stranger(tmp_path / "stranger.glb", scheme)
    before, _ = unpack(rig)
    opened = PosedGlb(export(airborne, tmp_path / "out.glb", rig=rig))
    for frame in LOOK:
        assert max(off(opened, airborne, frame, scheme).values()) < 0.05
    assert opened.names[: len(before["nodes"])] == [node["name"] for node in before["nodes"]]
    assert opened.gltf.skins[0].joints == before["skins"][0]["joints"]
    for frame in (0, 20):  # bones are the rig's own
        opened.at(airborne.timestamps[frame])
        way = {body: opened.place(named(f"l_{body}", scheme)) for pair in BONES for body in pair}
        lengths = [np.linalg.norm(way[upper] - way[lower]) for upper, lower in BONES]
        np.testing.assert_allclose(lengths, [0.24, 0.21, np.hypot(0.48, 0.01), np.hypot(0.42, 0.01)], atol=1e-4)
        sizes = np.ptp(opened.vertices.reshape(-1, 8, 3), axis=1).max(axis=1)
        assert sizes.max() < 0.6  # in metres, though the file has centimetres
    Character.load(tmp_path / "out.glb")


def test_hands_feet_head_and_trunk_turn_as_ours(airborne, tmp_path):
    """On the box figure, whose T-pose is the neutral body's."""
    opened = PosedGlb(export(airborne, tmp_path / "out.glb", rig=stranger(tmp_path / "stranger.glb")))
    before, _ = unpack(tmp_path / "stranger.glb")
    rest = PosedGlb.array(opened, before["skins"][0]["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2)
    at_rest = turns_at_rest(airborne.character)
    skeleton, upright = airborne.character.skeleton, np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    for frame in LOOK:
        opened.at(airborne.timestamps[frame])
        for body, most in (("pelvis", 0.01), ("chest", 0.01), ("head", 0.01), ("l_foot", 6), ("l_hand", 12)):
            node = opened.names.index(named(body))
            moved = (opened.worlds[node] @ rest[node])[:3, :3] @ np.linalg.inv(0.01 * upright) / 100 / 0.01
            moved = moved / np.cbrt(np.linalg.det(moved))
            ours = airborne.body_transforms[frame, skeleton.body_names.index(body), :3, :3].astype(float)
            if body in at_rest:
                ours = ours @ at_rest[body]
            assert np.degrees(Rotation.from_matrix(moved @ ours.T).magnitude()) < most, body


def turns_at_rest(character: Character) -> dict[str, np.ndarray]:
    """How hand and foot rest: the one by the angles of the table, the other by where heel and toes are."""
    from jaxmocap.exporters._neutral_body import neutral_body

    skeleton = character.skeleton
    hand = neutral_body(skeleton).turns[skeleton.body_names.index("l_hand")].T
    toes = np.asarray(skeleton.landmark("l_big_toe") + skeleton.landmark("l_small_toe")) / 2
    x, _, z = toes - np.asarray(skeleton.landmark("l_heel"))
    return {"l_hand": hand, "l_foot": Rotation.from_rotvec([0, np.arctan2(x, z), 0]).as_matrix()}


def test_a_foot_that_stands_does_not_slide_and_no_foot_sinks(standing, tmp_path):
    rig, said = stranger(tmp_path / "stranger.glb"), []
    opened = PosedGlb(export(standing, tmp_path / "out.glb", rig=rig, say=said.append))
    body = Humanoid()
    of = {side: np.isin(body.bone, [body.names.index(f"{side}_{name}") for name in ("foot", "toe")]) for side in "lr"}
    paths, angles = [], []
    for frame in range(len(standing)):
        angles.append(off(opened, standing, frame))
        paths.append(opened.vertices)
    paths = np.stack(paths)
    left = paths[6:39, of["l"]]
    assert np.linalg.norm(left - left[0], axis=2).max() < 0.001
    assert "planted feet slide by up to 0.0 cm (0.0 cm in the motion)" in said[0]
    thighs = [each["l_thigh"] for each in angles]
    assert max(thighs[6:39]) > 1  # which takes bending the legs otherwise than ours
    ground = float(np.asarray(standing.character.vertices)[:, 1].min())  # the left foot is where it rests
    assert left[..., 1].min() == pytest.approx(ground, abs=0.002)
    skeleton = standing.character.skeleton
    for side in "lr":
        foot = np.asarray(standing.character.weights)[:, skeleton.body_names.index(f"{side}_foot")] > 0.5
        ours = np.array([standing.vertices(frame)[foot, 1].min() for frame in range(len(standing))]) - ground
        assert (paths[:, of[side], 1].min(axis=1) - ground > np.minimum(ours, 0) - 0.005).all()
    speed = np.linalg.norm(np.diff(paths[:, of["l"]].mean(axis=1), axis=0), axis=1) * 30
    assert speed.max() < 0.3  # on its way to where it stands


def test_contacts_of_a_dance_are_kept_though_nobody_looked_for_them(source, tmp_path):
    said = []
    export(source, tmp_path / "out.glb", rig=stranger(tmp_path / "stranger.glb"), say=said.append)
    words = said[0].split()
    after, before = float(words[words.index("cm") - 1]), float(said[0].split("(")[1].split()[0])
    assert 0 < after < before + 0.15


def test_a_world_with_z_up_is_the_same_motion(standing, tmp_path):
    rig = stranger(tmp_path / "stranger.glb")
    upright = export(standing, tmp_path / "y.bvh", rig=rig).read_text()
    again = export(turned(standing, "z"), tmp_path / "again.bvh", rig=rig).read_text()
    values = [np.array(text.split("Frame Time")[1].split()[2:], float) for text in (upright, again)]
    np.testing.assert_allclose(*values, atol=1e-2)


@pytest.mark.parametrize(("up", "units", "factor"), [("y", "m", 1), ("z", "cm", 100)])
def test_bvh_has_the_rig_s_joints_where_glb_has_them(standing, tmp_path, up, units, factor):
    rig = stranger(tmp_path / "stranger.glb", ROCKETBOX)
    opened = PosedGlb(export(standing, tmp_path / "out.glb", rig=rig)).at(standing.timestamps[17])
    path = export(standing, tmp_path / "out.bvh", rig=rig, up=up, units=units)
    joints = bvhsdk.ReadFile(str(path)).getlistofjoints()
    expected = Humanoid().renamed(ROCKETBOX)
    assert sorted(joint.name for joint in joints) == sorted(name.replace(" ", "_") for name in expected)
    turn = np.eye(3) if up == "y" else np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    for name in expected:
        found = next(joint for joint in joints if joint.name == name.replace(" ", "_"))
        where = turn @ opened.place(name)
        np.testing.assert_allclose(np.asarray(found.getPosition(17)) / factor, where, atol=2e-4)


def test_a_spine_of_more_joints_shares_the_bend_and_fingers_follow_their_hand(airborne, tmp_path):
    rig, mapping = stranger(tmp_path / "stranger.glb"), tmp_path / "mapping.toml"
    mapping.write_text('"mixamorig:Spine2" = "chest"\n')
    opened = PosedGlb(export(airborne, tmp_path / "out.glb", rig=rig, mapping=mapping))
    before, _ = unpack(rig)
    bend = []
    for name in ("Spine", "Spine1", "Spine2"):
        node = opened.names.index(f"mixamorig:{name}")
        keys = Rotation.from_quat(opened.keys(node, "rotation"))
        still = np.array(before["nodes"][node]["matrix"]).reshape(4, 4).T[:3, :3]
        bend.append(np.degrees((Rotation.from_matrix(still).inv() * keys).magnitude()))
    np.testing.assert_allclose(bend[1], bend[2], atol=0.01)
    assert bend[1].max() > 1
    finger = opened.keys(opened.names.index("mixamorig:LeftHandIndex1"), "rotation")
    assert np.ptp(finger, axis=0).max() < 1e-5
    moved = opened.keys(opened.names.index("mixamorig:LeftHandIndex1"), "translation")
    assert moved is None or np.ptp(moved, axis=0).max() < 1e-5


def test_joints_above_the_pelvis_stay(airborne, tmp_path):
    body = Humanoid()
    names = ["root", *body.renamed(UNREAL)]
    parents, places = [-1, *(parent + 1 for parent in body.parents)], np.vstack([[0, 0, 0], body.places])
    weights = np.pad(body.weights, ((0, 0), (1, 0)))
    rig = write_glb(tmp_path / "unreal.glb", names, parents, places, body.vertices, body.faces, weights)
    opened = PosedGlb(export(airborne, tmp_path / "out.glb", rig=rig))
    assert opened.keys(opened.names.index("root"), "rotation") is None
    for frame in LOOK:
        assert max(off(opened, airborne, frame, UNREAL).values()) < 0.05
        np.testing.assert_allclose(opened.place("root"), 0, atol=1e-6)


@pytest.fixture(scope="module")
def result(source, tmp_path_factory) -> Path:
    return source.save(tmp_path_factory.mktemp("result") / "dance")


def test_the_command_writes_files_of_one_rig(result, tmp_path, capsys):
    rig = stranger(tmp_path / "stranger.glb")
    files = [tmp_path / "a.glb", tmp_path / "a.bvh"]
    assert run(["export", str(result), "--to", *map(str, files), "--rig", str(rig), "--json"]) == 0
    out, err = capsys.readouterr()
    assert [Path(row["file"]) for row in json.loads(out)["files"]] == files
    assert err.count("as the legs of stranger.glb are") == 2
    assert "mixamorig:LeftForeArm" in files[1].read_text()


def test_what_is_said_names_the_file_asked_for_where_blender_writes_it(standing, tmp_path, monkeypatch):
    monkeypatch.setenv("JAXMOCAP_BLENDER", sys.executable)  # which has no bpy of its own
    said = []
    with pytest.raises(InputError, match="Blender could not write"):
        export(standing, tmp_path / "dance.fbx", rig=stranger(tmp_path / "stranger.glb"), say=said.append)
    assert said[0].startswith("dance.fbx: the path is scaled")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--to", "a.glb", "--rig", "nobody.glb"], "nobody.glb does not exist"),
        (
            ["--to", "a.glb", "a.c3d", "--rig", "good.glb"],
            "a.c3d is not written on a rig, as .glb, .bvh, .fbx and .blend",
        ),
        (["--to", "a.glb", "--rig", "good.glb", "--actor", "good.glb"], "the rig is somebody else's; name one of them"),
        (["--to", "a.glb", "--mapping", "good.toml"], "names the joints of a rig, and none is given"),
        (["--to", "a.glb", "--rig", "bare.glb"], "holds a mesh but no skin"),
        (["--to", "a.glb", "--rig", "legless.glb"], "is not recognised as a person: no joint was found for l_thigh"),
        (["--to", "a.glb", "--rig", "rootless.glb"], "has no joint from which both legs and the head hang"),
        (["--to", "a.bvh", "--rig", "text.glb"], "is not a glTF file"),
        (["--to", "a.glb", "--rig", "sheared.glb"], "stretches unevenly"),
    ],
)
def test_a_rig_that_cannot_be_moved_is_one_sentence_and_leaves_nothing(
    arguments, words, result, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    stranger(Path("good.glb"))
    document, binary = unpack(Path("good.glb"))
    del document["skins"]
    for node in document["nodes"]:
        node.pop("skin", None)
    pack(Path("bare.glb"), document, binary)
    body = Humanoid(drop=("upleg", "leg", "foot", "toe"))
    write_glb(
        Path("legless.glb"), body.renamed(MIXAMO), body.parents, body.places, body.vertices, body.faces, body.weights
    )
    body = Humanoid()
    parents = [-1 if name.endswith("upleg") else parent for name, parent in zip(body.names, body.parents, strict=True)]
    write_glb(Path("rootless.glb"), body.renamed(MIXAMO), parents, body.places, body.vertices, body.faces, body.weights)
    write_glb(
        Path("sheared.glb"),
        body.renamed(MIXAMO),
        body.parents,
        body.places,
        body.vertices,
        body.faces,
        body.weights,
        np.diag([1.0, 1.3, 1.0, 1.0]),
    )
    Path("text.glb").write_text("no glTF")
    there = {path.name for path in tmp_path.iterdir()}
    assert run(["export", str(result), *arguments]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert words in err
    assert {path.name for path in tmp_path.iterdir()} == there


def test_python_refuses_a_rig_for_other_formats(source, tmp_path):
    for suffix, exporter in EXPORTERS.items():
        if not exporter.rigged:
            with pytest.raises(InputError, match="leave the rig out"):
                export(source, tmp_path / f"a{suffix}", rig=tmp_path / "any.glb")
