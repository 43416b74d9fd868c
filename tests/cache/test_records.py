"""Records come back exactly, and a file can only build records."""

import json
from collections import deque

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap._cache import Stand, UnreadableRecord, digest, read_records, write_records
from jaxmocap.appearance import AppearanceSettings
from jaxmocap.character import Pose
from jaxmocap.observation import FrameImages, Rectangle


def _value():
    return {
        "pose": Pose(jnp.eye(4), jnp.arange(33.0)),
        (4, 0.25): Rectangle(np.array([[4, 8]]), 16, 12, 7.5),
        "row": deque([None, True, 3, 0.1, "a <b>", np.float32(0.1)], maxlen=7),
        "nothing": (np.nan, -np.inf, [], {}),
        "picture": np.arange(24, dtype=np.uint8).reshape(2, 4, 3),
        "settings": AppearanceSettings(behind="plate"),
    }


def _same(one, other):
    assert type(one) is type(other)
    if isinstance(one, dict):
        assert list(one) == list(other)
        one, other = list(one.values()), list(other.values())
    if isinstance(one, deque):
        assert one.maxlen == other.maxlen
    if isinstance(one, list | tuple | deque):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            _same(a, b)
    elif isinstance(one, np.ndarray | jax.Array | np.generic | eqx.Module):
        for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
            assert np.asarray(a).dtype == np.asarray(b).dtype
            np.testing.assert_array_equal(a, b)
    elif isinstance(one, float):
        assert one == other or (np.isnan(one) and np.isnan(other))
    elif isinstance(one, Rectangle):
        _same(vars(one), vars(other))
    else:
        assert one == other


def test_a_record_comes_back_as_it_was(tmp_path):
    value = _value()
    write_records(tmp_path / "state.npz", value)
    back = read_records(tmp_path / "state.npz")
    _same(value, back)
    assert back["settings"].behind == "plate"
    assert digest(back) == digest(value)


def test_known_objects_and_stands_are_not_stored(tmp_path):
    large, shown = np.zeros(1_000_000), FrameImages(3, 0.1, [np.zeros((500, 500, 3), np.uint8)])
    stands = (Stand(FrameImages, lambda item: item.frame, lambda frame: ("decoded", frame)),)
    write_records(tmp_path / "a.npz", [large, shown], {"table": large}, stands)
    assert (tmp_path / "a.npz").stat().st_size < 2000
    found, decoded = read_records(tmp_path / "a.npz", {"table": large}, stands)
    assert found is large
    assert decoded == ("decoded", 3)


def test_the_digest_changes_with_every_part():
    seen = {digest(_value())}
    for key, other in (("picture", np.zeros(3)), ("row", [1]), ("pose", Pose(jnp.eye(4), jnp.zeros(33)))):
        seen.add(digest({**_value(), key: other}))
    assert len(seen) == 4
    assert digest(np.zeros(2, np.float32)) != digest(np.zeros(2, np.int32))
    assert digest(np.sort) != digest(np.argsort)


@pytest.mark.parametrize("bad", [object(), np.array([object()]), {1}, print])
def test_other_values_are_refused(tmp_path, bad):
    with pytest.raises(TypeError):
        write_records(tmp_path / "a.npz", [bad])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "tree",
    [
        {"record": "os:system", "fields": {}},
        {"record": "jaxmocap._cache._records:write_records", "fields": {}},
        {"record": "jaxmocap._cache._records:json.loads", "fields": {}},
        {"record": "jaxmocap.character:Pose", "fields": {"root": 1}},
        {"record": "jaxmocap.nowhere:Pose", "fields": {}},
        {"known": "gone"},
        {"array": 5},
        {"spell": 1},
    ],
)
def test_a_file_builds_nothing_but_records(tmp_path, tree):
    np.savez(tmp_path / "a.npz", __tree__=np.asarray(json.dumps(tree)))
    with pytest.raises(UnreadableRecord, match=r"a\.npz"):
        read_records(tmp_path / "a.npz")


def test_damage_is_named(tmp_path):
    write_records(tmp_path / "a.npz", _value())
    data = (tmp_path / "a.npz").read_bytes()
    for broken in (data[:-40], data[: len(data) // 2], b"", b"text", bytes(len(data))):
        (tmp_path / "a.npz").write_bytes(broken)
        with pytest.raises(UnreadableRecord):
            read_records(tmp_path / "a.npz")
