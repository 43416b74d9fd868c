"""What cannot be loaded is refused in one sentence that says what to do."""

import struct

import humanoid_glb
import numpy as np
import pytest

from jaxmocap._results import InputError
from jaxmocap.character import Character


@pytest.fixture
def glb(tmp_path, humanoid):
    """Writes the box figure with some parts replaced."""

    def write(names=None, **changes):
        mesh = {"places": humanoid.places, "vertices": humanoid.vertices, "faces": humanoid.faces}
        mesh |= {"weights": humanoid.weights, **changes}
        names = names or humanoid.renamed(humanoid_glb.MIXAMO)
        return humanoid_glb.write_glb(tmp_path / "figure.glb", names, humanoid.parents, **mesh)

    return write


@pytest.fixture
def edited(tmp_path, glb):
    """Writes the box figure with its JSON edited."""

    def write(edit):
        document, binary = humanoid_glb.unpack(glb())
        edit(document)
        return humanoid_glb.pack(tmp_path / "edited.glb", document, binary)

    return write


def refused(path, words, mapping=None):
    with pytest.raises(InputError, match=words) as caught:
        Character.load(path, mapping)
    message = str(caught.value)
    assert message.endswith(".")
    assert "\n" not in message


def test_missing_file(tmp_path):
    refused(tmp_path / "nobody.glb", "does not exist")


@pytest.mark.parametrize("content", [b"", b"solid cube\n", b"\x89PNG\r\n", b"v 0 0 0\n" * 50])
def test_not_a_gltf_file(tmp_path, content):
    (tmp_path / "thing.glb").write_bytes(content)
    refused(tmp_path / "thing.glb", "not a glTF file")


def test_json_that_is_not_gltf(tmp_path):
    (tmp_path / "thing.gltf").write_text('{"version": 3}')
    refused(tmp_path / "thing.gltf", "JSON but not glTF")


@pytest.mark.parametrize("keep", [5, 15, 100, 2000, -1])
def test_truncated_file(glb, keep):
    path = glb()
    path.write_bytes(path.read_bytes()[:keep])
    refused(path, "cut short")


def test_every_truncation_is_refused_cleanly(glb):
    path = glb()
    data = path.read_bytes()
    for keep in np.linspace(4, len(data) - 1, 60).astype(int):
        path.write_bytes(data[:keep])
        with pytest.raises(InputError):
            Character.load(path)


def test_declared_length_beyond_the_file(glb):
    path = glb()
    data = bytearray(path.read_bytes())
    data[8:12] = struct.pack("<I", 2**31)
    path.write_bytes(data)
    refused(path, "declares 2147483648 bytes")


def test_old_version(glb):
    path = glb()
    data = bytearray(path.read_bytes())
    data[4:8] = struct.pack("<I", 1)
    path.write_bytes(data)
    refused(path, "glTF version 1")


EDITS = {
    "no mesh": (lambda d: d.update(meshes=[], nodes=[{}]), "holds no mesh"),
    "no skin": (lambda d: d.update(skins=[]), "no skin; rig it first"),
    "unused skin": (lambda d: d["nodes"][-1].pop("skin"), "skin that no mesh uses"),
    "huge accessor": (lambda d: d["accessors"][0].update(count=2**40), "needs .* bytes"),
    "huge view": (
        lambda d: d["bufferViews"][0].update(byteLength=2**40) or d["accessors"][0].update(count=2**36),
        "needs",
    ),
    "negative count": (lambda d: d["accessors"][0].update(count=-3), "impossible sizes"),
    "offset past the end": (lambda d: d["accessors"][0].update(byteOffset=10**9), "needs"),
    "no such accessor": (
        lambda d: d["meshes"][0]["primitives"][0]["attributes"].update(POSITION=99),
        "accessors number 99",
    ),
    "no such node": (lambda d: d["nodes"][0].update(children=[999]), "nodes number 999"),
    "no such joint": (lambda d: d["skins"][0]["joints"].__setitem__(4, 999), "nodes number 999"),
    "no binds": (lambda d: d["skins"][0].pop("inverseBindMatrices"), "without inverse bind matrices"),
    "sparse": (lambda d: d["accessors"][0].update(sparse={"count": 1}), "sparse"),
    "draco": (lambda d: d.update(extensionsRequired=["KHR_draco_mesh_compression"]), "compressed with KHR_draco"),
    "no weights": (lambda d: d["meshes"][0]["primitives"][0]["attributes"].pop("WEIGHTS_0"), "weights"),
    "two parents": (lambda d: d["nodes"][1].update(children=[0]), "more than one parent"),
    "ring of nodes": (
        lambda d: d["nodes"][-2].pop("children") and d["nodes"][1]["children"].append(0),
        "own ancestors",
    ),
    "lines": (lambda d: d["meshes"][0]["primitives"][0].update(mode=1), "without triangles"),
}


@pytest.mark.parametrize("name", EDITS)
def test_broken_documents(edited, name):
    edit, words = EDITS[name]
    refused(edited(edit), words)


def test_index_out_of_range(glb, humanoid):
    refused(glb(faces=np.concatenate([humanoid.faces, [[0, 1, 60000]]])), "point past its .* vertices")


def test_weights_for_a_joint_that_is_not_there(edited):
    def edit(document):
        document["skins"][0]["joints"] = document["skins"][0]["joints"][:-4]

    refused(edited(edit), "weights for joint")


@pytest.mark.parametrize("what", ["vertices", "weights"])
def test_numbers_that_are_not_finite(glb, humanoid, what):
    values = {"vertices": humanoid.vertices, "weights": humanoid.weights}[what].copy()
    values[3] = np.nan
    refused(glb(**{what: values}), r"not finite \(first at vertex 3\)")


def test_vertices_without_weights(glb, humanoid):
    weights = humanoid.weights.copy()
    weights[7] = 0
    refused(glb(weights=weights), "1 vertices without skinning weights")


@pytest.mark.parametrize(("factor", "unit"), [(100, "centimetres, scale it by 0.01"), (1000, "millimetres")])
def test_wrong_units(glb, humanoid, factor, unit):
    refused(glb(places=factor * humanoid.places, vertices=factor * humanoid.vertices), f"it looks like {unit}")


def test_absurdly_small(glb, humanoid):
    refused(glb(places=1e-3 * humanoid.places, vertices=1e-3 * humanoid.vertices), "expected 0.3 to 3")


def test_left_and_right_exchanged(glb, humanoid):
    names = humanoid.renamed(humanoid_glb.MIXAMO)
    swapped = [n.replace("Left", "?").replace("Right", "Left").replace("?", "Right") for n in names]
    refused(glb(names=swapped), "left and right joints exchanged")


def test_a_skin_that_is_no_person(tmp_path):
    places = np.array([[0, 0.3 * n, 0] for n in range(6)])
    vertices, faces, bone = humanoid_glb.boxes(places, places + [0, 0.29, 0])
    names = [f"segment{n}" for n in range(6)]
    path = humanoid_glb.write_glb(
        tmp_path / "worm.glb", names, [-1, 0, 1, 2, 3, 4], places, vertices, faces, np.eye(6)[bone]
    )
    refused(path, "not recognised as a person: no joint was found for chest, head, l_upper_arm.*mapping file")


def test_mapping_to_an_unknown_body(glb):
    refused(glb(), "'tail' is not one of our bodies; use one of pelvis", {"mixamorig:Hips": "tail"})


def test_mapping_of_an_unknown_joint(glb):
    refused(glb(), "no joint named 'Schwanz'; its joints are mixamorig:Hips", {"Schwanz": "pelvis"})


@pytest.mark.parametrize(("name", "text"), [("map.toml", "= 3"), ("map.json", "{"), ("map.json", '{"a": {"b": "c"}}')])
def test_unreadable_mapping(tmp_path, glb, name, text):
    (tmp_path / name).write_text(text)
    refused(glb(), "map", tmp_path / name)


def test_absent_mapping(tmp_path, glb):
    refused(glb(), "does not exist; a mapping is", tmp_path / "none.toml")


def test_buffer_outside_the_folder(tmp_path, glb):
    document, _ = humanoid_glb.unpack(glb())
    document["buffers"][0]["uri"] = "../../secret.bin"
    refused(humanoid_glb.pack(tmp_path / "outside.glb", document, b""), "outside its own folder")
