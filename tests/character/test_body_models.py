"""Files of the SMPL family: made up here, with the joints and arrays that the real ones have."""

import numpy as np
import pytest

from jaxmocap import InputError
from jaxmocap.character import Character
from jaxmocap.character._body_model import _NAMES

_PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19]
_FINGERS = [parent for wrist, start in ((20, 0), (21, 15)) for parent in ([wrist, None, None] * 5)]


def parents_of(count: int) -> list[int]:
    """The tree of the body's 22 joints, then the hands' (SMPL) or jaw, eyes and three joints per finger."""
    if count == 24:
        return [*_PARENTS, 20, 21]
    tree = [*_PARENTS, *([15, 15, 15] if count == 55 else [])]
    for parent in _FINGERS:
        tree.append(len(tree) - 1 if parent is None else parent)
    return tree


def model(humanoid, count: int) -> dict[str, np.ndarray]:
    """The box figure's mesh, whose joints an SMPL file's regressor would find: each is the mean of some vertices."""
    at = dict(zip(humanoid.names, humanoid.places, strict=True))
    part = {"Pelvis": "hips", "Spine1": "spine", "Spine2": "spine1", "Spine3": "spine2", "Neck": "neck", "Head": "head"}
    limb = {"Collar": "shoulder", "Shoulder": "arm", "Elbow": "forearm", "Wrist": "hand"}
    limb |= {"Hip": "upleg", "Knee": "leg", "Ankle": "foot", "Foot": "toe"}
    part |= {f"{s.upper()}_{ours}": f"{s}_{theirs}" for s in "lr" for ours, theirs in limb.items()}
    names, tree = _NAMES[count], parents_of(count)
    vertices, weights = humanoid.vertices, np.zeros((len(humanoid.vertices), count))
    regressor = np.zeros((count, len(vertices)))
    for number in range(count):
        holder = number
        while names[holder] not in part:
            holder = tree[holder]
        mine = part[names[holder]]
        place = np.asarray(at[mine]) + (0.0 if holder == number else 0.02)
        basis = np.vstack([vertices.T, np.ones(len(vertices))])
        regressor[number] = np.linalg.lstsq(basis, np.append(place, 1.0), rcond=None)[0]
    own = [names.index(next((n for n, p in part.items() if p == theirs), "Pelvis")) for theirs in _kept(humanoid, part)]
    for theirs, column in zip(range(len(humanoid.names)), own, strict=True):
        weights[:, column] += humanoid.weights[:, theirs]
    kintree = np.array([[2**32 - 1, *tree[1:]], range(count)])
    return {
        "v_template": vertices,
        "f": np.asarray(humanoid.faces, np.uint32),
        "weights": weights,
        "J_regressor": regressor,
        "kintree_table": kintree,
    }


def _kept(humanoid, part) -> list[str]:
    """For every joint of the figure the nearest ancestor that SMPL has."""
    found = []
    for number in range(len(humanoid.names)):
        while humanoid.names[number] not in part.values():
            number = humanoid.parents[number]
        found.append(humanoid.names[number])
    return found


@pytest.mark.parametrize("count", [24, 52, 55])
def test_a_model_gets_the_joints_of_the_same_figure_as_gltf(count, humanoid, box_figure, tmp_path):
    np.savez(tmp_path / "model.npz", **model(humanoid, count))
    loaded = Character.load(tmp_path / "model.npz")
    for joint in ("neck", *(f"{s}_{j}" for s in "lr" for j in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle"))):
        np.testing.assert_allclose(loaded.skeleton.landmark(joint), box_figure.skeleton.landmark(joint), atol=1e-4)
    assert loaded.faces.shape == box_figure.faces.shape
    weights, expected = np.asarray(loaded.weights), np.asarray(box_figure.weights)
    limbs = [n for n, name in enumerate(loaded.skeleton.body_names) if name[:2] in ("l_", "r_")]
    np.testing.assert_allclose(weights[:, limbs], expected[:, limbs], atol=1e-6)


def test_shape_coefficients_in_the_file_are_applied(humanoid, tmp_path):
    arrays = model(humanoid, 24)
    np.savez(tmp_path / "mean.npz", **arrays)
    directions = np.stack([0.1 * arrays["v_template"], np.zeros_like(arrays["v_template"])], axis=2)
    np.savez(tmp_path / "taller.npz", **arrays, shapedirs=directions, betas=np.array([1.0, 5.0]))
    mean, taller = (Character.load(tmp_path / f"{name}.npz") for name in ("mean", "taller"))
    ratio = np.ptp(np.asarray(taller.vertices)[:, 1]) / np.ptp(np.asarray(mean.vertices)[:, 1])
    assert ratio == pytest.approx(1.1, rel=1e-4)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: m.pop("weights"), "lacks weights"),
        (lambda m: m.update(J_regressor=np.array([[{}]], object)), "without pickled objects"),
        (lambda m: m.update(J_regressor=m["J_regressor"][:20]), "has 20 joints"),
        (lambda m: m.update(weights=m["weights"][:-1]), "has weights of shape"),
        (lambda m: m.update(f=m["f"] + 10**6), "point past"),
        (lambda m: m.update(betas=np.ones(10)), "betas but no shapedirs"),
    ],
)
def test_what_is_no_model_is_refused(change, words, humanoid, tmp_path):
    arrays = model(humanoid, 24)
    change(arrays)
    np.savez(tmp_path / "model.npz", **arrays)
    with pytest.raises(InputError, match=words):
        Character.load(tmp_path / "model.npz")


def test_a_broken_archive_is_refused(tmp_path):
    (tmp_path / "model.npz").write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(InputError, match="cannot be read"):
        Character.load(tmp_path / "model.npz")
    with pytest.raises(InputError, match="does not exist"):
        Character.load(tmp_path / "nothing.npz")
