"""Capsules around the bones have the radii of limbs whose girth is known."""

import json
import struct

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.character import BodyShape, Character, capsules, scaled
from jaxmocap.synthetic import make_actor

GIRTHS = {  # circumferences in metres
    "l_upper_arm": 0.31,
    "r_forearm": 0.25,
    "l_thigh": 0.55,
    "r_shank": 0.37,
}
ENDS = {"upper_arm": ("shoulder", "elbow"), "forearm": ("elbow", "wrist"), "thigh": ("hip", "knee")}
ENDS |= {"shank": ("knee", "ankle")}


@pytest.fixture(scope="module")
def turned_on_a_lathe() -> Character:
    """The actor with some limbs of circular section and known circumference."""
    actor = make_actor()
    vertices, owner = np.array(actor.vertices, float), np.asarray(actor.weights).argmax(axis=1)
    for body, girth in GIRTHS.items():
        a, b = (np.asarray(actor.skeleton.landmark(body[:2] + joint), float) for joint in ENDS[body[2:]])
        own = owner == actor.skeleton.body_names.index(body)
        foot = a + np.outer((vertices[own] - a) @ (b - a) / np.sum((b - a) ** 2), b - a)
        off = vertices[own] - foot
        vertices[own] = foot + girth / (2 * np.pi) * off / np.linalg.norm(off, axis=1, keepdims=True)
    return eqx.tree_at(lambda c: c.vertices, actor, jnp.asarray(vertices, jnp.float32))


@pytest.mark.parametrize("body", list(GIRTHS))
def test_the_radius_is_that_of_the_girth(body, turned_on_a_lathe):
    found, number = capsules(turned_on_a_lathe), turned_on_a_lathe.skeleton.body_names.index(body)
    assert found.radii[number] == pytest.approx(GIRTHS[body] / (2 * np.pi), rel=1e-3)
    joint = turned_on_a_lathe.skeleton.landmark(body[:2] + ENDS[body[2:]][1])
    np.testing.assert_allclose(found.ends[number], joint, atol=1e-6)


def test_a_spike_does_not_change_it(turned_on_a_lathe):
    number = turned_on_a_lathe.skeleton.body_names.index("l_thigh")
    own = np.flatnonzero(np.asarray(turned_on_a_lathe.weights).argmax(axis=1) == number)
    spiked = eqx.tree_at(
        lambda c: c.vertices, turned_on_a_lathe, turned_on_a_lathe.vertices.at[own[::40]].multiply(1.1)
    )
    before, after = capsules(turned_on_a_lathe).radii[number], capsules(spiked).radii[number]
    assert after == pytest.approx(before, rel=0.02)


def test_every_bone_has_one_alike_on_both_sides_and_thicker_where_the_body_is():
    actor = make_actor()
    names, found = actor.skeleton.body_names, capsules(actor)
    radius = dict(zip(names, found.radii, strict=True))
    assert min(radius.values()) > 0.015
    assert max(radius.values()) < 0.2
    for name in names:
        if name.startswith("l_"):
            assert radius[name] == pytest.approx(radius["r_" + name[2:]], rel=0.05)
    assert radius["chest"] > radius["l_thigh"] > radius["l_shank"] > radius["l_forearm"]
    giant = capsules(scaled(actor, BodyShape.of(0.2)))
    np.testing.assert_allclose(giant.radii, np.exp(0.2) * found.radii, rtol=1e-3)


def test_hands_and_feet_are_enclosed_from_end_to_end():
    actor = make_actor()
    found, owner = capsules(actor), np.asarray(actor.weights).argmax(axis=1)
    for body in ("l_hand", "r_foot"):
        number = actor.skeleton.body_names.index(body)
        skin = np.asarray(actor.vertices, float)[owner == number]
        way = found.ends[number] - found.starts[number]
        reach = (skin - found.starts[number]) @ way / np.linalg.norm(way)
        assert reach.min() == pytest.approx(-found.radii[number], abs=2e-3)
        assert reach.max() == pytest.approx(np.linalg.norm(way) + found.radii[number], abs=2e-3)


def test_they_are_saved_in_the_glb_and_come_back(tmp_path, turned_on_a_lathe):
    path = turned_on_a_lathe.save_glb(tmp_path / "him.glb")
    data = path.read_bytes()
    document = json.loads(data[20 : 20 + struct.unpack("<I", data[12:16])[0]])
    saved = document["skins"][0]["extras"]["jaxmocap_capsules"]
    again = capsules(Character.load(path))
    for number, body in enumerate(turned_on_a_lathe.skeleton.body_names):
        assert saved[body]["radius"] == pytest.approx(again.radii[number], abs=1e-4)
        np.testing.assert_allclose(saved[body]["start"], again.starts[number], atol=1e-4)
        np.testing.assert_allclose(saved[body]["end"], again.ends[number], atol=1e-4)
