"""The doctor says that a sound installation is sound, and what is wrong with others."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from jaxmocap._cli import run
from jaxmocap.pipeline import Diagnosis, _doctor, _self_test, doctor
from jaxmocap.pipeline._doctor import WARMED, cache_state
from jaxmocap.pipeline._self_test import SelfTest, self_test


@pytest.fixture(scope="module")
def tests() -> list[SelfTest]:
    heard = []
    done = self_test(lambda *told: heard.append(told))
    assert heard == [("self-test", number, 5) for number in range(6)]
    return done


def test_every_step_of_the_self_test_finds_the_known_answer(tests):
    assert [one.name for one in tests] == ["render", "energy", "gradient", "search", "video"]
    assert [one.said for one in tests if not one.passed] == []
    assert all(one.seconds > 0 for one in tests)


def test_the_self_test_fails_where_an_answer_is_wrong(monkeypatch):
    world = _self_test._World()
    upside_down = replace(world.truth, masks=world.truth.masks[..., ::-1, :])
    world.__dict__["truth"] = upside_down
    assert not world.render()[0]
    world.__dict__["scores"] = lambda moves: np.linspace(1, 0, len(moves))
    assert not world.energy_of_truth()[0]
    monkeypatch.setattr(_self_test, "write_overlay_video", lambda path, frames: path)
    step = _self_test._timed("video", world.video)
    assert not step.passed
    assert "test.mp4 does not exist" in step.said


def test_a_sound_installation_has_no_problems(monkeypatch):
    kept = {"folder": "/", "files": 0, "megabytes": 0.0, "writable": True}  # tests need not keep compiled programs
    monkeypatch.setattr(_doctor, "cache_state", lambda: kept)
    found = doctor(test=False)
    assert found.problems == []
    assert found.versions["jax"] == __import__("jax").__version__
    assert found.devices[0]["platform"] in ("cpu", "gpu", "tpu")
    assert found.decoders["H.264"]
    assert found.encodes
    assert found.system["cores"] >= 1
    assert set(found.extras) == set(_doctor.EXTRAS)
    monkeypatch.setattr(_doctor, "cache_state", lambda: kept | {"writable": False})
    assert ["compiled programs cannot be kept" in problem for problem in doctor(test=False).problems] == [True]
    monkeypatch.setattr(_doctor, "cache_state", lambda: kept | {"folder": None, "writable": False})
    assert ["call jm.configure()" in problem for problem in doctor(test=False).problems] == [True]


def test_what_is_compiled_ahead_tells_how_far_it_is_and_counts_in_the_cache(monkeypatch):
    """The stages are those of the tracked film; the cache is looked at when all is compiled."""
    order = []

    def track(film, out, *, progress, **others):
        progress("track", 0, 6)
        order.append("compiled")

    def state():
        order.append("counted")
        return {"folder": "/", "files": 0, "megabytes": 0.0, "writable": True}

    monkeypatch.setattr(_doctor, "make_capture", lambda *size: size)
    monkeypatch.setattr(_doctor, "write_capture", lambda capture, folder: folder)
    monkeypatch.setattr(_doctor, "track_capture", track)
    monkeypatch.setattr(_doctor, "cache_state", state)
    heard = []
    found = doctor(test=False, warm=True, progress=lambda *told: heard.append(told))
    assert heard == [("film to compile with", 0, 1), ("film to compile with", 1, 1), ("track", 0, 6)]
    assert order == ["compiled", "counted"]
    assert 0 <= found.warmed < 60


def test_the_cache_is_counted(monkeypatch, tmp_path):
    def at(folder):
        monkeypatch.setattr(_doctor, "jax", SimpleNamespace(config=SimpleNamespace(jax_compilation_cache_dir=folder)))
        return cache_state()

    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "one").write_bytes(bytes(1_500_000))
    (tmp_path / "two").write_bytes(bytes(500_000))
    assert at(str(tmp_path)) == {"folder": str(tmp_path), "files": 2, "megabytes": 2.0, "writable": True}
    assert at(str(tmp_path / "later" / "on"))["writable"]
    assert at(str(tmp_path / "two" / "below"))["files"] == 0
    assert not at(None)["writable"]


def test_what_is_missing_or_of_the_wrong_version_is_named(monkeypatch):
    known = dict.fromkeys(_doctor.PACKAGES, "1.0") | {"python": "3.11", "trimesh": "not installed"}
    monkeypatch.setattr(_doctor, "versions", lambda packages: known)
    monkeypatch.setattr(
        _doctor, "requires", lambda name: ["numpy>=2.0", "scipy>=0.9", 'pyarrow>=9; extra == "parquet"']
    )
    monkeypatch.setattr(_doctor, "_has_codec", lambda name, mode: False)
    problems = doctor(test=False).problems
    assert "trimesh is not installed; install jaxmocap again" in problems
    assert any("numpy is 1.0, jaxmocap needs >=2.0" in problem for problem in problems)
    assert not any("scipy" in problem or "pyarrow" in problem for problem in problems)
    assert any("H.264" in problem for problem in problems)


def diagnosis(**changes) -> Diagnosis:
    passed = SelfTest("render", True, "as it should be", 1.0)
    found = Diagnosis(
        versions={"python": "3.11"},
        system={"platform": "Linux", "cores": 2, "memory_gb": None, "free_disk_gb": 10.0},
        devices=[{"name": "cpu:0", "kind": "cpu", "platform": "cpu", "memory_gb": None}],
        cache={"folder": "/cache", "files": 3, "megabytes": 1.5, "writable": True},
        decoders={"H.264": True, "VP9": False},
        encodes=True,
        extras=dict.fromkeys(_doctor.EXTRAS),
        tests=[passed],
        problems=[],
    )
    return replace(found, **changes)


def test_the_command_tells_everything_and_exits_with_1_if_something_is_wrong(monkeypatch, capsys):
    monkeypatch.setattr(
        "jaxmocap.pipeline.doctor", lambda test, warm, progress: diagnosis(warmed=83.0 if warm else None)
    )
    assert run(["doctor"]) == 0
    out = capsys.readouterr().out
    assert "All is well." in out
    assert "VP9" not in out
    assert "compiled ahead" not in out
    assert run(["doctor", "--warm"]) == 0
    warmed = capsys.readouterr().out.replace("\u2502", " ").split()
    assert f"in 83 s: {WARMED}" in " ".join(warmed)
    assert "jaxmocap[usd]" in out.replace("\n", "")
    wrong = diagnosis(tests=[SelfTest("search", False, "found nothing", 2.0)], problems=["the self-test failed"])
    monkeypatch.setattr("jaxmocap.pipeline.doctor", lambda test, warm, progress: wrong)
    assert run(["doctor", "--json"]) == 1
    out, err = capsys.readouterr()
    assert json.loads(out)["tests"][0]["said"] == "found nothing"
    assert "self-test" in err
    assert run(["doctor", "--no-test"]) == 1
    assert "Problem: the self-test failed." in capsys.readouterr().out
