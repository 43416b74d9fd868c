"""MHR's body: files made up here, with the joints and arrays that the real ones have."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxmocap import InputError, body
from jaxmocap._cli import run
from jaxmocap.synthetic import make_actor

JOINTS = ("neck", *(f"{s}_{j}" for s in "lr" for j in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")))
NAMES = {"pelvis": "root", "abdomen": "c_spine0", "chest": "c_spine2", "head": "c_neck", "clavicle": "clavicle"}
NAMES |= {"upper_arm": "uparm", "forearm": "lowarm", "hand": "wrist", "thigh": "upleg", "shank": "lowleg"}


def files() -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """The procedural actor as MHR's `rig.npz` and `lod1.npz`: centimetres, every joint's space turned and scaled."""
    actor, draw = make_actor(1.7), np.random.default_rng(0)
    skeleton, weights = actor.skeleton, np.asarray(actor.weights)
    sided = [("", name) if name[1] != "_" else (name[:2], name[2:]) for name in skeleton.body_names]
    names = ["body_world", *(side + NAMES.get(part, part) for side, part in sided)]
    places = 100 * np.vstack([np.zeros(3), np.asarray(skeleton.landmarks, float)[: len(sided)]])
    turns, scales = Rotation.random(len(names), random_state=0), draw.uniform(0.8, 1.2, len(names))
    rig = {
        "schema_version": np.array(1),
        "joint_names": np.array(names),
        "joint_parents": np.array([-1, *(parent + 1 for parent in skeleton.parents)], np.int32),
        "inverse_bind_pose": np.column_stack([-scales[:, None] * turns.apply(places), turns.as_quat(), scales]),
    }
    owners = np.argsort(-weights, axis=1)[:, :8]
    vertices = 100 * np.asarray(actor.vertices, float)
    mesh = {
        "schema_version": np.array(1),
        "base_shape": vertices,
        "shape_vectors": np.stack([vertices * [0.1, 0, 0], 0 * vertices]),
        "faces": np.asarray(actor.faces, np.int32),
        "skin_indices": (owners + 1).astype(np.int32),
        "skin_weights": np.take_along_axis(weights, owners, axis=1),
    }
    return rig, mesh


@pytest.fixture
def assets(tmp_path):
    folder = tmp_path / "assets"
    folder.mkdir()
    rig, mesh = files()
    np.savez(folder / "rig.npz", **rig)
    np.savez(folder / "lod1.npz", **mesh)
    return folder


def test_joints_weights_and_shapes_are_the_figure_s(assets):
    made, expected = body(model="mhr", assets=assets, num_faces=10**6), make_actor(1.7)
    for joint in JOINTS:
        np.testing.assert_allclose(made.skeleton.landmark(joint), expected.skeleton.landmark(joint), atol=1e-3)
    np.testing.assert_allclose(np.sort(made.weights, axis=0), np.sort(expected.weights, axis=0), atol=1e-3)
    wider = body(model="mhr", assets=assets, parameters={"shape0": 2.0}, num_faces=10**6)
    ratio = np.ptp(np.asarray(wider.vertices), axis=0) / np.ptp(np.asarray(made.vertices), axis=0)
    np.testing.assert_allclose(ratio, [1.2, 1, 1], atol=1e-3)


def test_the_command_writes_a_character(assets, tmp_path, capsys):
    out = tmp_path / "man.glb"
    wishes = ["--height", "1.85", "--triangles", "3000", "--assets", str(assets)]
    assert run(["body", "--model", "mhr", "--out", str(out), *wishes, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["height_m"] == pytest.approx(1.85, abs=1e-3)
    assert run(["body", "--model", "mhr", "--out", str(tmp_path / "other.glb")]) == 2
    assert "github.com/facebookresearch/MHR/releases" in "".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("rig.npz", None, "does not hold MHR's rig.npz"),
        ("rig.npz", lambda arrays: arrays.pop("joint_names"), "without joint_names"),
        ("rig.npz", lambda arrays: arrays.update(schema_version=np.array(2)), "version 2"),
        ("rig.npz", lambda arrays: arrays.update(joint_parents=arrays["joint_parents"][1:]), "do not fit together"),
        ("rig.npz", lambda arrays: arrays["inverse_bind_pose"].fill(np.nan), "not finite"),
        ("rig.npz", lambda arrays: arrays.update(joint_names=np.array([{}], object)), "cannot be read"),
        ("lod1.npz", lambda arrays: arrays.update(faces=arrays["faces"] + 10**6), "do not fit together"),
        ("lod1.npz", lambda arrays: arrays.update(skin_indices=arrays["skin_indices"][:, 0]), "no such table"),
    ],
)
def test_damaged_files_are_refused(name, change, words, assets):
    rig, mesh = files()
    arrays = rig if name == "rig.npz" else mesh
    (assets / name).unlink()
    if change is not None:
        change(arrays)
        np.savez(assets / name, **arrays)
    with pytest.raises(InputError, match=words):
        body(model="mhr", assets=assets)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"parameters": {"shape2": 1.0}}, "'shape2' is no parameter of MHR; use shape0 to shape1"),
        ({"parameters": {"weight": 1.0}}, "'weight' is no parameter"),
        ({"parameters": {"shape0": float("nan")}}, "shape0 is nan"),
        ({"model": "built-in"}, "does not use"),
    ],
)
def test_what_makes_no_body_is_refused(options, words, assets):
    with pytest.raises(InputError, match=words):
        body(**{"model": "mhr", "assets": assets} | options)
