"""`Character.load` on files of many dialects: names, places, units, orientations, encodings, seams."""

import json
from dataclasses import replace

import humanoid_glb
import numpy as np
import pytest

from jaxmocap.character import BODIES, Character, build_skeleton, rest_pose, skin

BODY_NAMES = [name for name, _, _ in BODIES]
QUARTER = {"z up": [[1, 0, 0], [0, 0, -1], [0, 1, 0]], "facing left": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]}


def save(tmp_path, figure, names, **changes):
    parts = {"places": figure.places, "vertices": figure.vertices, "faces": figure.faces, "weights": figure.weights}
    return humanoid_glb.write_glb(tmp_path / "file.glb", names, figure.parents, **{**parts, **changes})


def rename(path, target, names):
    """The same GLB with other joint names."""
    document, binary = humanoid_glb.unpack(path)
    for node in document["nodes"]:
        node["name"] = names(node["name"])
    return humanoid_glb.pack(target, document, binary)


def assert_same(a: Character, b: Character, atol: float = 1e-5) -> None:
    np.testing.assert_allclose(a.vertices, b.vertices, atol=atol)
    np.testing.assert_array_equal(a.faces, b.faces)
    np.testing.assert_allclose(a.weights, b.weights, atol=atol)
    np.testing.assert_allclose(a.skeleton.landmarks, b.skeleton.landmarks, atol=atol)
    np.testing.assert_allclose(a.skeleton.axes, b.skeleton.axes, atol=10 * atol)
    assert float(a.misfit) == pytest.approx(float(b.misfit), abs=1e-6)


def test_joints_go_to_the_bodies_they_belong_to(box_figure, humanoid):
    expected = {"hips": "pelvis", "spine": "abdomen", "spine1": "chest", "spine2": "chest", "neck": "head"}
    expected |= {"head": "head", "shoulder": "clavicle", "arm": "upper_arm", "forearm": "forearm", "hand": "hand"}
    expected |= {"index": "hand", "middle": "hand", "thumb": "hand", "upleg": "thigh", "leg": "shank"}
    expected |= {"foot": "foot", "toe": "foot"}
    middles = np.asarray(box_figure.vertices)
    for number, name in enumerate(humanoid.names):
        side, base = (name[:2], name[2:]) if name[:2] in ("l_", "r_") else ("", name)
        for corner in humanoid.vertices[humanoid.bone == number]:
            vertex = np.argmin(np.sum((middles - corner) ** 2, axis=1))
            assert box_figure.weights[vertex, BODY_NAMES.index(side + expected[base])] > 0, name


def test_joint_positions_are_those_of_the_inverse_bind_matrices(box_figure, humanoid):
    places = dict(zip(humanoid.names, humanoid.places, strict=True))
    for joint, name in {"pelvis": "hips", "neck": "neck", "head": "head", "l_clavicle": "l_shoulder"}.items():
        np.testing.assert_allclose(box_figure.skeleton.landmark(joint), places[name], atol=1e-6)
    for joint, name in {"r_shoulder": "r_arm", "r_wrist": "r_hand", "l_knee": "l_leg", "l_ankle": "l_foot"}.items():
        np.testing.assert_allclose(box_figure.skeleton.landmark(joint), places[name], atol=1e-6)


@pytest.mark.parametrize("scheme", humanoid_glb.NAMES)
def test_naming_schemes_give_the_same_character(tmp_path, box_figure, humanoid, scheme):
    loaded = Character.load(save(tmp_path, humanoid, humanoid.renamed(humanoid_glb.NAMES[scheme])))
    assert_same(loaded, box_figure)


def test_nameless_joints_are_recognised_by_place(tmp_path, box_figure, humanoid):
    names = [f"joint_{number:02d}" for number in range(len(humanoid.names))]
    assert_same(Character.load(save(tmp_path, humanoid, names)), box_figure)


@pytest.mark.parametrize("view", QUARTER)
@pytest.mark.parametrize("named", [True, False])
def test_rotated_files_give_the_same_character(tmp_path, box_figure, humanoid, view, named):
    turn = np.array(QUARTER[view], float)
    names = humanoid.renamed(humanoid_glb.MIXAMO) if named else [f"node{n}" for n in range(len(humanoid.names))]
    path = save(tmp_path, humanoid, names, places=humanoid.places @ turn.T, vertices=humanoid.vertices @ turn.T)
    loaded = Character.load(path)
    assert_same(loaded, box_figure)


def test_file_facing_any_direction_gives_the_same_character(tmp_path, box_figure, humanoid):
    angle = np.radians(37)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    mesh = {"places": humanoid.places @ turn.T, "vertices": humanoid.vertices @ turn.T}
    loaded = Character.load(save(tmp_path, humanoid, humanoid.renamed(humanoid_glb.UNREAL), **mesh))
    np.testing.assert_allclose(loaded.vertices, box_figure.vertices, atol=1e-5)
    np.testing.assert_allclose(loaded.skeleton.axes, box_figure.skeleton.axes, atol=1e-4)


def test_armature_in_centimetres_and_z_up_is_undone(tmp_path, box_figure, humanoid):
    """As Blender and FBX converters write it: mesh in centimetres, the node above the skeleton scales and turns it."""
    turn = np.array(QUARTER["z up"], float)
    armature = np.eye(4)
    armature[:3, :3] = turn.T * 0.01
    mesh = {"places": 100 * humanoid.places @ turn.T, "vertices": 100 * humanoid.vertices @ turn.T}
    names = humanoid.renamed(humanoid_glb.MIXAMO)
    assert_same(Character.load(save(tmp_path, humanoid, names, armature=armature, **mesh)), box_figure)


@pytest.mark.parametrize("weight_type", ["u1", "u2"])
def test_normalised_integer_weights_are_read(tmp_path, box_figure, humanoid, weight_type):
    blended = (
        0.75 * humanoid.weights + 0.25 * np.eye(len(humanoid.names))[np.maximum(humanoid.parents, 0)][humanoid.bone]
    )
    names = humanoid.renamed(humanoid_glb.VRM)
    exact = Character.load(save(tmp_path, humanoid, names, weights=blended))
    assert_same(Character.load(save(tmp_path, humanoid, names, weights=blended, weight_type=weight_type)), exact, 3e-3)


def test_seams_are_welded_and_inward_faces_turned(tmp_path, box_figure, humanoid):
    soup = humanoid.faces.reshape(-1)
    mesh = {"vertices": humanoid.vertices[soup], "weights": humanoid.weights[soup]}
    mesh["faces"] = np.arange(len(soup)).reshape(-1, 3)[:, ::-1]
    mesh["faces"] = np.concatenate([mesh["faces"], [[0, 0, 1], [2, 5, 2]]])
    loaded = Character.load(save(tmp_path, humanoid, humanoid.renamed(humanoid_glb.MIXAMO), **mesh))
    assert loaded.vertices.shape == box_figure.vertices.shape
    assert loaded.faces.shape == box_figure.faces.shape
    volume = lambda c: np.linalg.det(np.asarray(c.vertices, float)[np.asarray(c.faces)]).sum() / 6  # noqa: E731
    assert volume(loaded) == pytest.approx(volume(box_figure), rel=1e-4)
    assert volume(loaded) > 0


@pytest.mark.parametrize("absent", [("spine1",), ("spine1", "spine2"), ("spine", "spine1"), ("neck",), ("shoulder",)])
def test_fewer_joints_still_make_a_person(tmp_path, absent):
    figure = humanoid_glb.Humanoid(drop=absent)
    loaded = Character.load(save(tmp_path, figure, figure.renamed(humanoid_glb.MIXAMO)))
    heights = [float(loaded.skeleton.landmark(name)[1]) for name in ("pelvis", "spine", "thorax", "neck", "head")]
    assert heights == sorted(heights)
    np.testing.assert_allclose(np.asarray(loaded.weights).sum(axis=1), 1, atol=1e-6)
    trunk = np.asarray(loaded.weights).sum(axis=0)[:3]
    assert np.all(trunk > 0.5), trunk
    moved = np.asarray(skin(loaded, rest_pose(loaded.skeleton)))
    np.testing.assert_allclose(moved, loaded.vertices, atol=1e-6)


@pytest.mark.parametrize("kind", ["dict", "json", "toml"])
def test_mapping_file_names_odd_joints(tmp_path, box_figure, humanoid, kind):
    odd = dict(zip(humanoid.names, (f"knochen {n}" for n in range(len(humanoid.names))), strict=True))
    bodies = {"hips": "pelvis", "spine": "abdomen", "spine1": "chest", "neck": "head"}
    limbs = {"shoulder": "clavicle", "arm": "upper_arm", "forearm": "forearm", "hand": "hand"}
    limbs |= {"upleg": "thigh", "leg": "shank", "foot": "foot"}
    bodies |= {f"{side}_{name}": f"{side}_{body}" for side in "lr" for name, body in limbs.items()}
    mapping = {odd[name]: body for name, body in bodies.items()}
    path = save(tmp_path, humanoid, list(odd.values()))
    if kind == "json":
        (tmp_path / "map.json").write_text(json.dumps(mapping))
    elif kind == "toml":
        (tmp_path / "map.toml").write_text("".join(f'"{joint}" = "{body}"\n' for joint, body in mapping.items()))
    loaded = Character.load(path, mapping if kind == "dict" else tmp_path / f"map.{kind}")
    np.testing.assert_allclose(loaded.weights, box_figure.weights, atol=1e-6)
    np.testing.assert_allclose(loaded.skeleton.axes, box_figure.skeleton.axes, atol=1e-5)


def test_meshes_with_skins_of_their_own_are_one_character(tmp_path, box_figure, humanoid):
    """Some exporters give hair, face and clothes a skin each: the joints in another order, the mesh elsewhere."""
    names, whole = humanoid.renamed(humanoid_glb.MIXAMO), humanoid
    first = 8 * (6 * len(whole.vertices) // 80)  # the boxes of the first bones
    of_first = (whole.faces < first).all(1)
    path = save(
        tmp_path,
        whole,
        names,
        vertices=whole.vertices[:first],
        faces=whole.faces[of_first],
        weights=whole.weights[:first],
    )
    document, binary = humanoid_glb.unpack(path)
    count, away = len(names), np.array([0.3, -0.2, 0.5])
    binds = np.tile(np.eye(4), (count, 1, 1))
    binds[:, :3, 3] = -whole.places - away
    order = np.argsort(-whole.weights[first:], axis=1)[:, :4]
    arrays = [
        ((whole.vertices[first:] + away).astype("<f4"), "VEC3", 5126),
        ((whole.faces[~of_first] - first).reshape(-1).astype("<u2"), "SCALAR", 5123),
        ((count - 1 - order).astype("<u2"), "VEC4", 5123),
        (np.take_along_axis(whole.weights[first:], order, axis=1).astype("<f4"), "VEC4", 5126),
        (binds[::-1].transpose(0, 2, 1).reshape(-1, 16).astype("<f4"), "MAT4", 5126),
    ]
    for array, kind, component in arrays:
        document["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": array.nbytes})
        accessor = {"componentType": component, "count": len(array), "type": kind}
        document["accessors"].append({"bufferView": len(document["bufferViews"]) - 1, **accessor})
        binary += array.tobytes() + b"\0" * (-array.nbytes % 4)
    document["buffers"][0]["byteLength"] = len(binary)
    attributes = {"POSITION": 5, "JOINTS_0": 7, "WEIGHTS_0": 8}
    document["meshes"].append({"primitives": [{"attributes": attributes, "indices": 6}]})
    document["skins"].append({"joints": list(range(count))[::-1], "inverseBindMatrices": 9})
    document["skins"][0]["joints"].pop()  # which only the second mesh has
    document["nodes"].append({"name": "clothes", "mesh": 1, "skin": 1})
    document["scenes"][0]["nodes"].append(len(document["nodes"]) - 1)
    assert_same(Character.load(humanoid_glb.pack(tmp_path / "two.glb", document, binary)), box_figure)


def test_text_gltf_with_a_buffer_beside_it_is_read(tmp_path, box_figure, humanoid):
    document, binary = humanoid_glb.unpack(save(tmp_path, humanoid, humanoid.renamed(humanoid_glb.MIXAMO)))
    document["buffers"][0]["uri"] = "my%20figure.bin"
    (tmp_path / "my figure.bin").write_bytes(binary)
    (tmp_path / "figure.gltf").write_text(json.dumps(document))
    assert_same(Character.load(tmp_path / "figure.gltf"), box_figure)


@pytest.mark.parametrize("name", ["box_figure", "actor"])
def test_saved_characters_load_back_unchanged(request, tmp_path, name):
    character = request.getfixturevalue(name)
    assert_same(Character.load(character.save_glb(tmp_path / "saved.glb")), character, atol=1e-7)


@pytest.mark.parametrize(("written", "read"), [(0.01, 0.01), (-1, 0), ("wide", 0), (None, 0)])
def test_the_misfit_of_a_body_made_to_measure_is_saved_with_it(tmp_path, box_figure, written, read):
    path = replace(box_figure, misfit=0.01).save_glb(tmp_path / "saved.glb")
    document, binary = humanoid_glb.unpack(path)
    document["skins"][0]["extras"]["jaxmocap_misfit"] = written
    loaded = Character.load(humanoid_glb.pack(tmp_path / "changed.glb", document, binary))
    assert float(loaded.misfit) == pytest.approx(read)


def test_saved_file_is_an_ordinary_glb_for_other_programs(tmp_path, actor):
    path = actor.save_glb(tmp_path / "saved.glb")
    document, _ = humanoid_glb.unpack(path)
    del document["skins"][0]["extras"]
    plain = humanoid_glb.pack(tmp_path / "plain.glb", document, humanoid_glb.unpack(path)[1])
    loaded = Character.load(plain)
    np.testing.assert_allclose(loaded.weights, actor.weights, atol=1e-6)
    np.testing.assert_allclose(loaded.skeleton.axes, actor.skeleton.axes, atol=1e-5)


def test_mesh_landmarks_lie_on_the_surface_where_they_should(actor):
    at = lambda name: np.asarray(actor.skeleton.landmark(name))  # noqa: E731
    assert at("nose")[2] > at("head")[2] + 0.08
    assert at("l_eye")[0] > 0.02 > -0.02 > at("r_eye")[0]
    assert at("l_ear")[0] > 0.05 > -0.05 > at("r_ear")[0]
    for side, sign in (("l", 1), ("r", -1)):
        assert at(f"{side}_toe")[2] > at(f"{side}_ankle")[2] + 0.12
        assert at(f"{side}_heel")[2] < at(f"{side}_ankle")[2]
        assert sign * (at(f"{side}_small_toe") - at(f"{side}_big_toe"))[0] > 0.03
        assert max(at(f"{side}_toe")[1], at(f"{side}_heel")[1]) < 0.06


def actor_names(scheme):
    """Names of the shipped actor's 17 joints in another scheme."""
    ours = {"hips": "hips", "spine": "spine", "chest": "spine1", "neck": "neck", "head": "head"}
    limbs = {"upper_arm": "arm", "forearm": "forearm", "hand": "hand", "thigh": "upleg", "shin": "leg", "foot": "foot"}

    def name(old: str) -> str:
        side, _, part = old.partition("_")
        if part in limbs:
            base = scheme[limbs[part]]
            return base.format(Side=side.capitalize(), S=side[0].upper(), s=side[0])
        return scheme[ours[old]] if old in ours else old

    return name


@pytest.mark.parametrize("scheme", humanoid_glb.NAMES)
def test_the_actor_renamed_is_the_same_actor(tmp_path, actor, actor_path, scheme):
    path = rename(actor_path, tmp_path / "renamed.glb", actor_names(humanoid_glb.NAMES[scheme]))
    assert_same(Character.load(path), actor)


def test_the_actor_without_names_is_the_same_actor(tmp_path, actor, actor_path):
    assert_same(Character.load(rename(actor_path, tmp_path / "nameless.glb", lambda old: "")), actor)


def test_the_actors_of_both_captures_load(actor_path):
    for capture in ("plaza", "street"):
        path = actor_path.parents[1] / capture / "actor.glb"
        if not path.is_file():
            pytest.skip(f"{path} is absent; set JAXMOCAP_DATA to the captures")
        character = Character.load(path)
        assert 2400 < len(character.vertices) < 2600
        assert float(np.ptp(character.vertices[:, 1])) == pytest.approx(
            {"plaza": 1.749, "street": 1.614}[capture], abs=2e-3
        )
        np.testing.assert_allclose(np.asarray(character.weights).sum(axis=1), 1, atol=1e-6)
        assert character.name == "actor"


def test_a_mesh_with_joints_and_weights_becomes_a_character(box_figure):
    skeleton = box_figure.skeleton
    parts = (np.asarray(part) for part in (box_figure.vertices, box_figure.faces, box_figure.weights))
    names = [name for name in skeleton.landmark_names if "toe" not in name and name != "nose"]
    made = Character.from_mesh("made", *parts, {name: np.asarray(skeleton.landmark(name)) for name in names})
    assert_same(made, box_figure, atol=1e-6)


def test_skeleton_of_a_character_is_that_of_its_joints(box_figure):
    names = box_figure.skeleton.landmark_names
    joints = dict(zip(names, np.asarray(box_figure.skeleton.landmarks), strict=True))
    np.testing.assert_allclose(build_skeleton(joints).axes, box_figure.skeleton.axes, atol=1e-5)
