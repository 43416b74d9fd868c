"""Clips of BVH and GLB files as motions: our own come back, and those of others point where they pointed."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from humanoid_glb import MIXAMO, SMPL, Humanoid, pack, unpack
from scipy.spatial.transform import Rotation

import jaxmocap as jm
from jaxmocap._cli import run
from jaxmocap._results import InputError
from jaxmocap.motion import Motion
from jaxmocap.synthetic import make_actor, make_capture

POSER = {
    **{"hips": "Hips", "spine": "Chest", "neck": "Neck", "head": "Head", "shoulder": "{Side}Collar"},
    **{"arm": "{Side}Shoulder", "forearm": "{Side}Elbow", "hand": "{Side}Wrist", "upleg": "{Side}Hip"},
    **{"leg": "{Side}Knee", "foot": "{Side}Ankle", "toe": "{Side}Toe"},
}
LIMBS = [(f"{s}_{a}", f"{s}_{b}") for s in "lr" for a, b in (("shoulder", "elbow"), ("elbow", "wrist"))]
LIMBS += [(f"{s}_{a}", f"{s}_{b}") for s in "lr" for a, b in (("hip", "knee"), ("knee", "ankle"))]


def directions(motion: Motion, bone: tuple[str, str]) -> np.ndarray:
    a, b = (motion.joints[:, motion.joint_names.index(name)].astype(float) for name in bone)
    return (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)


# Our own ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "form"), [("a.bvh", {}), ("cm.bvh", {"units": "cm", "up": "z"}), ("a.glb", {}), ("own.glb", {})]
)
def test_an_export_comes_back_as_the_motion_it_was(even, tmp_path, name, form):
    written = replace(even, provenance={}) if name == "own.glb" else even
    again = jm.read_motion(jm.export(written, tmp_path / name, **form), even.character)
    joints = again.joints if again.up == "y" else again.joints[..., [0, 2, 1]] * [1, 1, -1]
    np.testing.assert_allclose(joints, even.joints, atol=1e-4)
    np.testing.assert_allclose(again.angles, even.angles, atol=1e-3)
    start = even.timestamps[0] if name.endswith("glb") else 0
    np.testing.assert_allclose(again.timestamps - start, even.timestamps - even.timestamps[0], atol=1e-6)
    assert again.up == form.get("up", "y")


def test_a_skinned_file_brings_its_own_character(motion, tmp_path):
    again = jm.read_motion(jm.export(motion, tmp_path / "dance.glb"))
    np.testing.assert_allclose(again.vertices(3), motion.vertices(3), atol=1e-4)


def test_a_clip_goes_over_to_an_actor_in_another_rest_pose(even, tmp_path):
    """From a T-pose to an A-pose with bent elbows: limbs point the same way, and feet stay on the ground."""
    moved = jm.read_motion(jm.export(even, tmp_path / "dance.bvh"), make_actor(1.6))
    for bone in LIMBS:
        cosine = np.sum(directions(moved, bone) * directions(even, bone), axis=1)
        assert np.degrees(np.arccos(cosine.clip(-1, 1))).max() < 2
    heel = moved.joint_names.index("l_heel")
    assert abs(moved.joints[:, heel, 1].min() - even.joints[:, heel, 1].min()) < 0.03
    assert jm.read_motion(tmp_path / "dance.bvh", even.character, metres_per_unit=0.5).joints[0, 0, 1] < 0.6


# Those of others --------------------------------------------------------------------------------------------------


class Clip:
    """A figure of another program, in a T-pose, 40 units to the metre, its joints turned at random."""

    def __init__(self, scheme: dict[str, str], hanging: bool = False, num_frames: int = 5):
        drop = ("index", "middle", "thumb", *(("spine1", "spine2") if hanging else ()))
        self.body = Humanoid(drop)
        if hanging:
            self._let_arms_hang()
        self.names = self.body.renamed(scheme)
        rng = np.random.default_rng(1)
        self.angles = np.zeros((num_frames, len(self.names), 3))  # degrees about z, x, y, in this order
        for number, name in enumerate(self.body.names):
            base = name[2:] if name[:2] in ("l_", "r_") else name
            reach = {"arm": 60, "upleg": 35, "hips": 40, "spine": 10, "neck": 15}.get(base, 0)
            self.angles[:, number] = rng.uniform(-reach, reach, (num_frames, 3))
            if base == "forearm" and hanging:
                self.angles[:, number, 1] = -rng.uniform(20, 100, num_frames)
            elif base == "forearm":
                self.angles[:, number, 2] = (-1 if name[0] == "l" else 1) * rng.uniform(20, 100, num_frames)
            if base == "leg":
                self.angles[:, number, 1] = rng.uniform(10, 90, num_frames)
        self.path = np.cumsum(rng.uniform(-1, 1, (num_frames, 3)), axis=0) + [0, 40, 0]

    def _let_arms_hang(self) -> None:
        for side in "lr":
            shoulder = self.body.places[self.body.names.index(f"{side}_arm")]
            for name in ("forearm", "hand"):
                place = self.body.places[self.body.names.index(f"{side}_{name}")]
                place[:] = shoulder - [0, np.linalg.norm(place - shoulder), 0]

    def places(self) -> np.ndarray:
        """World places of all joints, in the file's units, by plain forward kinematics."""
        turns = [
            Rotation.from_euler("ZXY", self.angles[:, j], degrees=True).as_matrix() for j in range(len(self.names))
        ]
        worlds, places = [], []
        for joint, parent in enumerate(self.body.parents):
            if parent < 0:
                worlds.append(turns[joint])
                places.append(self.path)
                continue
            offset = 40 * (self.body.places[joint] - self.body.places[parent])
            places.append(places[parent] + worlds[parent] @ offset)
            worlds.append(worlds[parent] @ turns[joint])
        return np.stack(places, axis=1)

    def direction(self, bone: tuple[str, str]) -> np.ndarray:
        own = {"shoulder": "arm", "elbow": "forearm", "wrist": "hand", "hip": "upleg", "knee": "leg", "ankle": "foot"}
        a, b = (self.places()[:, self.body.names.index(f"{n[0]}_{own[n[2:]]}")] for n in bone)
        return (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)

    def bvh(self, path: Path) -> Path:
        """Positions at every joint, as some programs write them, and two orders of channels."""
        lines = ["HIERARCHY"]
        columns: list[np.ndarray] = []

        def write(joint: int) -> None:
            parent = self.body.parents[joint]
            offset = 40 * (self.body.places[joint] - (self.body.places[parent] if parent >= 0 else 0))
            turns = Rotation.from_euler("ZXY", self.angles[:, joint], degrees=True)
            order = "XYZ" if joint % 2 else "ZXY"
            lines.extend([("ROOT " if parent < 0 else "JOINT ") + self.names[joint], "{"])
            lines.append("OFFSET " + " ".join(map(str, offset)))
            spelled = " ".join(f"{axis}rotation" for axis in order)
            lines.append(f"CHANNELS 6 Xposition Yposition Zposition {spelled}")
            columns.extend([self.path if parent < 0 else np.tile(offset, (len(self.path), 1))])
            columns.append(turns.as_euler(order, degrees=True))
            children = [child for child, above in enumerate(self.body.parents) if above == joint]
            for child in children:
                write(child)
            if not children:
                lines.extend(["End Site", "{", "OFFSET 0 1 0", "}"])
            lines.append("}")

        write(0)
        lines += ["MOTION", f"Frames:\t{len(self.path)}", "Frame Time: 0.04"]
        lines += [" ".join(f"{value:.8f}" for value in row) for row in np.concatenate(columns, axis=1)]
        path.write_bytes("\r\n".join(lines).encode())
        return path


@pytest.mark.parametrize(
    ("scheme", "hanging"), [(MIXAMO, False), (SMPL, False), (POSER, True)], ids=["mixamo", "smpl", "poser"]
)
def test_limbs_of_a_foreign_clip_point_where_they_pointed(tmp_path, scheme, hanging):
    """T-poses, and arms that hang at rest with a trunk of one joint."""
    clip = Clip(scheme, hanging)
    character = make_actor()
    read = jm.read_motion(clip.bvh(tmp_path / "walk.bvh"), character)
    np.testing.assert_allclose(read.timestamps, 0.04 * np.arange(5), atol=1e-9)
    for bone in LIMBS:
        cosine = np.sum(directions(read, bone) * clip.direction(bone), axis=1)
        assert np.degrees(np.arccos(cosine.clip(-1, 1))).max() < 2, bone
    at = dict(zip(character.skeleton.landmark_names, np.asarray(character.skeleton.landmarks), strict=True))
    ours = np.linalg.norm(at["l_hip"] - at["l_knee"]) + np.linalg.norm(at["l_knee"] - at["l_ankle"])
    theirs = 0.40012 + 0.42012  # metres of the figure's thigh and shank
    np.testing.assert_allclose(read.joints[:, 0], clip.path / 40 * ours / theirs, atol=1e-3)


def test_a_clip_without_a_mesh_is_read_by_its_nodes(even, tmp_path):
    document, binary = unpack(jm.export(replace(even, cameras=None), tmp_path / "dance.glb"))
    expected = jm.read_motion(tmp_path / "dance.glb", even.character)
    for key in ("skins", "meshes"):
        del document[key]
    for node in document["nodes"]:
        node.pop("skin", None)
        node.pop("mesh", None)
    bare = jm.read_motion(pack(tmp_path / "bare.glb", document, binary), even.character)
    np.testing.assert_allclose(bare.joints, expected.joints, atol=2e-3)
    with pytest.raises(InputError, match="has no animation named 'run'; it has dancer"):
        jm.read_motion(tmp_path / "bare.glb", even.character, animation="run")


def test_a_synthetic_capture_can_be_driven_by_a_clip(even, tmp_path):
    actor = make_actor()
    moved = jm.read_motion(jm.export(even, tmp_path / "dance.bvh"), actor)
    shown = make_capture(3, (64, 48), motion=moved, fps=15)
    for frame in range(3):
        shift = shown.joints[frame] - moved.joints[2 * frame]
        np.testing.assert_allclose(shift, np.tile(shift[0], (len(shift), 1)), atol=1e-4)
        assert shown.masks[frame].any()
    with pytest.raises(InputError, match=r"lasts 0.367 s; 0.933 s are to be filmed"):
        make_capture(15, (64, 48), motion=moved, fps=15)
    with pytest.raises(InputError, match="a motion of make_actor"):
        make_capture(3, (64, 48), motion=even)


def test_the_command_makes_a_result_that_can_be_exported_again(even, actor, tmp_path, capsys):
    clip = jm.export(even, tmp_path / "dance.bvh", units="cm")
    assert run(["read-motion", str(clip), "--actor", str(actor), "--out", str(tmp_path / "result"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == len(even)
    assert run(["export", str(tmp_path / "result"), "--to", str(tmp_path / "again.glb")]) == 0
    assert "jaxmocap: " not in capsys.readouterr().err
    np.testing.assert_allclose(jm.read_motion(tmp_path / "again.glb").joints, even.joints, atol=1e-4)
    assert run(["read-motion", str(clip), "--out", str(tmp_path / "other")]) == 2
    assert "give the character that is to move" in capsys.readouterr().err
    assert not (tmp_path / "other").exists()


# Mistakes ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: "", "ends where HIERARCHY was expected"),
        (lambda text: "solid cube", "line 1 has 'solid' where HIERARCHY was expected"),
        (lambda text: text.replace("OFFSET", "OFSET", 1), "'OFSET', which does not belong there"),
        (lambda text: text.replace("Zrotation", "Wrotation", 1), "names the channel 'Wrotation'"),
        (lambda text: text.replace("Frames:\t5", "Frames:\t9"), "announces 9 frames of"),
        (lambda text: text.replace("Frames:\t5", "Frames:\tfive"), "'five' where a number was expected"),
        (lambda text: text.replace("0.04", "0"), "has the frame time 0"),
        (lambda text: text[: text.rindex(" ")], "announces 5 frames of"),
        (lambda text: text[: text.rindex(" ")] + " nan", "not a number"),
        (lambda text: text.replace("LeftLeg", "Tail"), "no joint was found for l_shank"),
        (lambda text: text[: text.index("MOTION")], "ends where more was expected"),
    ],
)
def test_a_damaged_bvh_is_one_sentence(tmp_path, change, words):
    path = Clip(MIXAMO).bvh(tmp_path / "walk.bvh")
    path.write_text(change(path.read_text()))
    with pytest.raises(InputError) as error:
        jm.read_motion(path, make_actor())
    assert str(path) in str(error.value)
    assert words in str(error.value)


def test_a_bvh_that_begins_with_a_byte_order_mark_is_read(even, tmp_path):
    path = jm.export(even, tmp_path / "a.bvh")
    expected = jm.read_motion(path, even.character)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    np.testing.assert_array_equal(jm.read_motion(path, even.character).angles, expected.angles)


def test_what_cannot_be_a_clip_is_refused(even, actor, tmp_path):
    with pytest.raises(InputError, match="none of the clips that are read"):
        jm.read_motion(tmp_path / "walk.fbx", even.character)
    with pytest.raises(InputError, match="does not exist"):
        jm.read_motion(tmp_path / "walk.bvh", even.character)
    with pytest.raises(InputError, match="give the character"):
        jm.read_motion(tmp_path / "walk.bvh")
    with pytest.raises(InputError, match="holds no animation"):
        jm.read_motion(actor, even.character)
    with pytest.raises(InputError, match="metres_per_unit is 0"):
        jm.read_motion(tmp_path / "walk.bvh", even.character, metres_per_unit=0)


def test_a_damaged_glb_is_never_a_traceback(even, tmp_path):
    whole = jm.export(even[:3], tmp_path / "dance.glb")
    document, binary = unpack(whole)
    rng = np.random.default_rng(0)
    paths = [("animations", 0, "samplers", 0), ("animations", 0, "channels", 0, "target"), ("skins", 0)]
    for number, where in enumerate(paths * 3):
        broken = json.loads(json.dumps(document))
        place = broken
        for step in where:
            place = place[step]
        for key in sorted(place.keys() - {"path"}):
            place[key] = [10**9, "nonsense", [[]]][rng.integers(3)]
        path = pack(tmp_path / f"broken{number}.glb", broken, binary)
        with pytest.raises(InputError) as error:
            jm.read_motion(path, even.character)
        assert str(path) in str(error.value)
