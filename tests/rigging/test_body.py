"""The built-in body has the height and proportions asked for."""

import json

import pytest
from bodies import tall

from jaxmocap import Character, InputError, body
from jaxmocap._cli import run
from jaxmocap.character import bone_lengths


@pytest.mark.parametrize("height", [1.5, 1.95])
def test_it_is_as_tall_as_asked_whatever_its_proportions(height):
    plain = body(height)
    other = body(height, {"thigh": 1.1, "upper_arm": 0.9}, {"torso": 1.3})
    assert tall(plain) == pytest.approx(height, abs=2e-3)
    assert tall(other) == pytest.approx(height, abs=2e-3)
    before, after = bone_lengths(plain.skeleton), bone_lengths(other.skeleton)
    ratio = {name: float(after[name] / before[name]) for name in before}
    assert ratio["thigh"] / ratio["shank"] == pytest.approx(1.1, rel=1e-3)
    assert ratio["upper_arm"] / ratio["forearm"] == pytest.approx(0.9, rel=1e-3)


def test_girths_change_no_bone():
    before, after = (bone_lengths(body(1.7, girths=girths).skeleton) for girths in ({}, {"thigh": 1.3, "shank": 0.8}))
    for name, length in before.items():
        assert float(after[name]) == pytest.approx(float(length), rel=5e-3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [((17.0,), "height is 17 m"), ((1.7, {"tail": 1.1}), "'tail' has no length"), ((1.7, None, {"head": 9}), "is 9;")],
)
def test_what_makes_no_person_is_refused(arguments, words):
    with pytest.raises(InputError, match=words):
        body(*arguments)


def test_the_command_writes_a_character(tmp_path, capsys):
    out = tmp_path / "him.glb"
    assert run(["body", "--out", str(out), "--height", "1.82", "--girths", "torso=1.1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["height_m"] == 1.82
    assert tall(Character.load(out)) == pytest.approx(1.82, abs=2e-3)
    assert run(["body", "--out", str(tmp_path / "her.glb"), "--lengths", "thigh"]) == 2
    assert "NAME=FACTOR" in capsys.readouterr().err
