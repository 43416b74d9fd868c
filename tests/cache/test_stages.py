"""Stages are made once for the same inputs, and never taken from a file that is not theirs."""

import os

import numpy as np

from jaxmocap._cache import _stages, cached_stage


def counted(folder, inputs, value=1.5):
    made = []

    def make():
        made.append(value)
        return {"value": value, "table": np.arange(1000.0)}

    found = cached_stage("stage", inputs, make, folder)
    assert found["value"] == value
    return len(made)


def test_a_stage_is_made_once_for_the_same_inputs(tmp_path):
    assert counted(tmp_path, {"seed": 0, "capture": "ab"}) == 1
    assert counted(tmp_path, {"seed": 0, "capture": "ab"}) == 0
    assert counted(tmp_path, {"seed": 1, "capture": "ab"}) == 1
    assert counted(tmp_path, {"seed": 0, "capture": "abc"}) == 1


def test_a_damaged_file_is_made_again(tmp_path):
    counted(tmp_path, {"seed": 0})
    (file,) = tmp_path.iterdir()
    for broken in (b"", file.read_bytes()[:-200], b"text" * 100):
        file.write_bytes(broken)
        assert counted(tmp_path, {"seed": 0}) == 1
        assert counted(tmp_path, {"seed": 0}) == 0


def test_a_folder_that_cannot_be_written_does_not_matter(tmp_path):
    (tmp_path / "file").write_text("")
    assert counted(tmp_path / "file" / "below", {"seed": 0}) == 1
    assert counted(tmp_path / "file" / "below", {"seed": 0}) == 1


def test_what_has_not_been_used_for_longest_goes_first(tmp_path, monkeypatch):
    for number in range(3):
        counted(tmp_path, {"seed": number})
    size = next(tmp_path.iterdir()).stat().st_size
    for age, file in enumerate(sorted(tmp_path.iterdir(), key=lambda path: path.stat().st_mtime_ns)):
        os.utime(file, (age, age))
    counted(tmp_path, {"seed": 0})  # used again: now the youngest
    monkeypatch.setattr(_stages, "LARGEST", int(2.5 * size))
    assert counted(tmp_path, {"seed": 3}) == 1
    assert len(list(tmp_path.iterdir())) == 2
    assert counted(tmp_path, {"seed": 0}) == 0
    assert counted(tmp_path, {"seed": 3}) == 0
