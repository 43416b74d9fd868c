"""GLB exports, posed by an independent reader."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from humanoid_glb import MIXAMO, Humanoid, unpack, write_glb
from posed_glb import PosedGlb
from scipy.spatial import cKDTree

from jaxmocap._results import InputError
from jaxmocap.camera import project
from jaxmocap.character import Character, Document
from jaxmocap.exporters import export
from jaxmocap.motion import Motion


@pytest.fixture(scope="module")
def opened(motion, tmp_path_factory) -> PosedGlb:
    return PosedGlb(export(motion, tmp_path_factory.mktemp("glb") / "dance.glb"))


def test_the_skin_and_the_joints_are_the_motion_s_at_its_own_times(opened, motion):
    np.testing.assert_allclose(opened.times, motion.timestamps, atol=1e-6)
    for frame in range(len(motion)):
        opened.at(motion.timestamps[frame])
        np.testing.assert_allclose(opened.vertices, motion.vertices(frame), atol=1e-4)
        for name, joint in (("mixamorig:LeftForeArm", "l_elbow"), ("mixamorig:RightFoot", "r_ankle")):
            expected = motion.joints[frame, motion.joint_names.index(joint)]
            np.testing.assert_allclose(opened.place(name), expected, atol=1e-4)


def test_the_actor_s_own_rig_is_kept(opened, actor):
    before, _ = unpack(actor)
    joints = len(before["skins"][0]["joints"])
    assert opened.names[: joints + 2] == [node["name"] for node in before["nodes"]]
    assert opened.names[:joints] == Humanoid().renamed(MIXAMO)
    assert [node.children or [] for node in opened.gltf.nodes[:joints]] == [
        node.get("children", []) for node in before["nodes"][:joints]
    ]
    assert opened.gltf.skins[0].inverseBindMatrices == before["skins"][0]["inverseBindMatrices"]
    fingers = opened.names.index("mixamorig:LeftHandIndex1")
    assert opened.gltf.nodes[fingers].translation == before["nodes"][fingers]["translation"]


def test_cameras_see_what_the_cameras_saw(opened, motion):
    for frame in (0, 3, 5):
        opened.at(motion.timestamps[frame])
        view = motion.cameras.at(frame)
        for camera, name in enumerate(motion.cameras.names):
            points = jnp.asarray(motion.joints[frame])
            pixels, _ = project(view.intrinsics[camera], view.cam_from_world[camera], points)
            seen, extras = opened.pixels(name, motion.joints[frame].astype(float))
            seen = seen * extras["size"] + extras["principal_point_off_centre"]
            np.testing.assert_allclose(seen, pixels, atol=0.05)
            np.testing.assert_allclose(extras["intrinsics"], motion.cameras.intrinsics[camera], rtol=1e-6)
            world_from_cam = opened.worlds[opened.names.index(name)] @ np.diag([1, -1, -1, 1])
            np.testing.assert_allclose(
                np.linalg.inv(world_from_cam), motion.cameras.cam_from_world[camera, frame], atol=1e-4
            )


def test_quaternions_never_change_sign_on_the_way(opened):
    for channel in opened.animation.channels:
        if channel.target.path == "rotation":
            keys = opened.array(opened.animation.samplers[channel.sampler].output)
            assert (np.sum(keys[1:] * keys[:-1], axis=1) > 0.5).all()


def test_the_file_says_how_it_is_to_be_read(opened, motion):
    note = opened.animation.extras["jaxmocap"]
    assert (note["units"], note["up"], note["frame_rate"], note["rig"]) == ("m", "+y", None, "the actor's own")
    assert note["mesh_off_by"] < 1e-6
    assert note["start"] == motion.timestamps[0]
    assert note["frames"] == motion.frames.tolist()


def test_contacts_are_in_the_extras_of_the_animation(opened, motion, tmp_path):
    contacts = [{"landmark": "l_heel", "first": 8, "last": 10}]
    standing = replace(motion, provenance={**motion.provenance, "contacts": contacts})
    content, _ = unpack(export(standing[2:], tmp_path / "standing.glb"))
    note = content["animations"][0]["extras"]["jaxmocap"]
    assert note["frames"][0] == 9
    assert note["contacts"] == [{"landmark": "l_heel", "first": 9, "last": 10}]
    content, _ = unpack(export(standing[5:], tmp_path / "walking.glb"))
    assert content["animations"][0]["extras"]["jaxmocap"]["contacts"] == []
    assert opened.animation.extras["jaxmocap"]["contacts"] is None  # they were not looked for


def test_a_world_with_z_up_is_laid_down(motion, tmp_path):
    turn = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # y up to z up
    upright = replace(motion, root=turn @ motion.root, joints=motion.joints @ turn[:3, :3].T, up="z", cameras=None)
    opened = PosedGlb(export(upright, tmp_path / "z.glb")).at(motion.timestamps[2])
    np.testing.assert_allclose(opened.vertices, motion.vertices(2), atol=1e-4)


def test_a_rig_that_is_gone_gives_way_to_our_own_joints(motion, tmp_path):
    said = []
    lost = replace(motion, provenance={"actor": str(tmp_path / "gone.glb")})
    opened = PosedGlb(export(lost, tmp_path / "own.glb", say=said.append)).at(motion.timestamps[4])
    assert "gone.glb is not there" in said[0]
    assert opened.animation.extras["jaxmocap"]["rig"] == "jaxmocap"
    np.testing.assert_allclose(opened.vertices, motion.vertices(4), atol=1e-4)
    expected = motion.joints[4, motion.joint_names.index("l_elbow")]
    np.testing.assert_allclose(opened.place("l_forearm"), expected, atol=1e-4)


def test_a_rig_with_one_joint_in_its_trunk_is_kept_and_the_difference_said(motion, tmp_path):
    body = Humanoid(drop=("spine1", "spine2"))
    names = body.renamed(MIXAMO)
    path = write_glb(tmp_path / "stiff.glb", names, body.parents, body.places, body.vertices, body.faces, body.weights)
    character, said = Character.load(path), []
    stiff = Motion.from_poses(character, motion.poses, motion.frames, motion.timestamps, provenance={"actor": path})
    opened = PosedGlb(export(stiff, tmp_path / "out.glb", say=said.append))
    off = opened.animation.extras["jaxmocap"]["mesh_off_by"]
    assert f"its mesh is off by up to {100 * off:.1f} cm" in said[0]
    furthest = 0.0
    for frame in range(len(stiff)):
        opened.at(stiff.timestamps[frame])
        expected = stiff.vertices(frame)[cKDTree(character.vertices).query(body.vertices)[1]]
        furthest = max(furthest, float(np.linalg.norm(opened.vertices - expected, axis=1).max()))
    assert furthest == pytest.approx(off, abs=1e-4)
    assert 0.001 < off < 0.1


def test_another_character_s_file_is_refused_where_it_is_asked_for(motion, tmp_path):
    other = replace_height(motion.character, 1.1).save_glb(tmp_path / "taller.glb")
    with pytest.raises(InputError, match="another character than the one that was tracked"):
        export(motion, tmp_path / "out.glb", actor=other)
    assert not (tmp_path / "out.glb").exists()


def replace_height(character: Character, factor: float) -> Character:
    places = dict(zip(character.skeleton.landmark_names, np.asarray(character.skeleton.landmarks), strict=True))
    joints = {name: factor * place for name, place in places.items()}
    vertices, faces, weights = (np.asarray(v) for v in (character.vertices, character.faces, character.weights))
    return Character.from_mesh("taller", factor * vertices, faces, weights, joints)


def test_the_exported_file_is_an_actor_like_the_one_it_came_from(motion, tmp_path):
    again = Character.load(export(motion, tmp_path / "dance.glb"))
    np.testing.assert_allclose(again.vertices, motion.character.vertices, atol=1e-6)


def test_colours_in_the_actor_s_file_are_kept(motion, tmp_path):
    colours = np.random.default_rng(0).integers(0, 256, motion.character.vertices.shape).astype(np.uint8)
    own = motion.character.save_glb(tmp_path / "own.glb", colours)
    before, after = (Document(file) for file in (own, export(motion, tmp_path / "dance.glb", actor=own)))
    found = [
        document.array(document.content["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"])
        for document in (before, after)
    ]
    np.testing.assert_array_equal(*found)
