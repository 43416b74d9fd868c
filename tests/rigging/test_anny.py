"""Anny's body: a figure of known joints under the package's interface, and the package itself where it is installed."""

import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from bodies import tall

from jaxmocap import Character, InputError, body
from jaxmocap._cli import run
from jaxmocap.rigging import _anny, turned_out
from jaxmocap.synthetic import make_actor

JOINTS = ("neck", *(f"{s}_{j}" for s in "lr" for j in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")))
NAMES = {"pelvis": "root", "abdomen": "spine05", "chest": "spine02", "head": "neck01", "clavicle": "clavicle"}
NAMES |= {"upper_arm": "upperarm01", "forearm": "lowerarm01", "hand": "wrist"}
NAMES |= {"thigh": "upperleg01", "shank": "lowerleg01", "foot": "foot"}
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


class Figure:
    """The interface of `anny.Anny`: the procedural actor, 1.2 to 2.2 m tall, z up; weight is width."""

    phenotype_labels = ("gender", "weight", "height")

    def __init__(self, **options):
        assert options == {"skinning_method": "lbs", "phenotype_blendshapes": "original"}
        self.actor = make_actor(1.0)
        skeleton = self.actor.skeleton
        sided = [name.partition("_") if name[1] == "_" else ("", "", name) for name in skeleton.body_names]
        self.bone_labels = [NAMES[part] + (f".{side.upper()}" if side else "") for side, _, part in sided]
        self.bone_parents = list(skeleton.parents)
        weights = np.asarray(self.actor.weights)
        self.vertex_bone_indices = np.argsort(-weights, axis=1)[:, :9]
        self.vertex_bone_weights = np.take_along_axis(weights, self.vertex_bone_indices, axis=1)

    def get_triangular_faces(self):
        return np.asarray(self.actor.faces)

    def __call__(self, phenotype_kwargs):
        wide = 1 + 0.2 * (phenotype_kwargs.get("weight", 0.5) - 0.5)
        tall = 1.2 + phenotype_kwargs.get("height", 0.5)
        there = tall * np.diag([wide, wide, 1.0]) @ Z_UP
        places = np.asarray(self.actor.skeleton.landmarks)[: len(self.bone_labels)]
        return {
            "rest_vertices": (np.asarray(self.actor.vertices) @ there.T)[None],
            "rest_bone_heads": (places @ there.T)[None],
        }


@pytest.fixture
def figure(monkeypatch):
    monkeypatch.setitem(sys.modules, "anny", SimpleNamespace(Anny=Figure))
    _anny._model.cache_clear()
    yield
    _anny._model.cache_clear()


@pytest.fixture
def anny():
    pytest.importorskip("anny", reason="the extra 'bodies' is not installed", exc_type=ImportError)
    _anny._model.cache_clear()


@pytest.mark.usefixtures("figure")
def test_joints_and_weights_are_the_figure_s():
    made, expected = body(model="anny", num_faces=10**6), make_actor(1.7)
    for joint in JOINTS:
        np.testing.assert_allclose(made.skeleton.landmark(joint), expected.skeleton.landmark(joint), atol=1e-3)
    assert tall(made) == pytest.approx(tall(expected), abs=1e-3)
    np.testing.assert_allclose(np.sort(made.weights, axis=0), np.sort(expected.weights, axis=0), atol=1e-3)


@pytest.mark.usefixtures("figure")
def test_a_height_chooses_the_parameter_and_lengths_change_bones():
    made = body(1.9, {"thigh": 1.1}, model="anny", parameters={"weight": 1.0}, num_faces=2000)
    assert tall(made) == pytest.approx(1.9, abs=2e-3)
    assert abs(len(made.faces) - 2000) < 100
    plain = body(1.9, model="anny", parameters={"weight": 1.0}, num_faces=2000)
    wide = np.ptp(np.asarray(plain.vertices)[:, 0]) / np.ptp(np.asarray(make_actor(1.9).vertices)[:, 0])
    assert wide == pytest.approx(1.1, abs=0.01)


@pytest.mark.usefixtures("figure")
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"parameters": {"tail": 0.5}}, "'tail' is no parameter of Anny; use gender, weight, height"),
        ({"parameters": {"weight": 1.5}}, "weight is 1.5; 0 to 1"),
        ({"parameters": {"weight": float("nan")}}, "weight is nan"),
        ({"parameters": {"height": 0.4}, "height": 1.7}, "both a height in metres"),
        ({"height": 2.4}, "1.20 to 2.20 m tall"),
        ({"num_faces": 10}, "10 triangles"),
        ({"model": "smpl"}, "no body model"),
        ({"model": "built-in", "parameters": {"weight": 0.5}}, "no parameters"),
    ],
)
def test_what_makes_no_body_is_refused(options, words):
    with pytest.raises(InputError, match=words):
        body(**{"model": "anny"} | options)


def test_without_the_package_one_sentence_says_what_to_install(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "anny", None)
    _anny._model.cache_clear()
    assert run(["body", "--model", "anny", "--out", str(tmp_path / "man.glb")]) == 2
    assert "pip install 'jaxmocap[bodies]'" in " ".join(capsys.readouterr().err.split())


def test_another_version_of_the_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "anny", SimpleNamespace())
    _anny._model.cache_clear()
    with pytest.raises(InputError, match="another interface"):
        body(model="anny")


@pytest.mark.usefixtures("figure")
def test_the_command_writes_a_character(tmp_path, capsys):
    out = tmp_path / "man.glb"
    wishes = ["--height", "1.6", "--parameters", "weight=0.8", "--triangles", "3000"]
    assert run(["body", "--model", "anny", "--out", str(out), *wishes, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["model"] == "anny"
    assert said["height_m"] == pytest.approx(1.6, abs=2e-3)
    assert tall(Character.load(out)) == pytest.approx(1.6, abs=2e-3)
    assert run(["body", "--out", str(tmp_path / "x.glb"), "--parameters", "weight"]) == 2
    assert "NAME=VALUE" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.usefixtures("anny")
def test_the_package_s_own_body_bends_where_a_person_does():
    """Slow: the first time the package prepares its meshes for minutes."""
    made = body(1.8, model="anny", parameters={"gender": 1.0, "muscle": 0.7})
    assert tall(made) == pytest.approx(1.8, abs=2e-3)
    assert abs(len(made.faces) - 5000) < 100
    assert turned_out(made) < 0.01
    at = {joint: np.asarray(made.skeleton.landmark(joint)) for joint in JOINTS}
    for joint in JOINTS[1:7]:
        np.testing.assert_allclose(at[joint] * (-1, 1, 1), at["r" + joint[1:]], atol=5e-3)
    assert at["l_ankle"][1] < at["l_knee"][1] < at["l_hip"][1] < at["l_shoulder"][1] < at["neck"][1]
    shares = {("hip", "knee"): 0.26, ("knee", "ankle"): 0.24, ("shoulder", "elbow"): 0.16, ("elbow", "wrist"): 0.14}
    for (upper, lower), share in shares.items():  # of the height
        length = np.linalg.norm(at[f"l_{upper}"] - at[f"l_{lower}"])
        assert length == pytest.approx(1.8 * share, abs=0.04)
