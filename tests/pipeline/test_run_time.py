"""The common time of the videos in `run`: found, given, or asked of the keypoints."""

from types import SimpleNamespace

import numpy as np
import pytest
from stand_ins import STAGES, again

from jaxmocap._results import InputError
from jaxmocap.camera import read_cameras
from jaxmocap.capture import Capture, PersonOffset, config_path, with_offsets
from jaxmocap.pipeline import _run_footage, run


def test_a_pair_that_nothing_ties_directly_is_no_obstacle(clips, done, tmp_path, monkeypatch):
    stand_in, said = _run_footage.sync, []

    def sync(folder, progress):
        record = stand_in(folder, progress).record() | {"pairs": [{"used": "sound"}, {"used": None}]}
        return SimpleNamespace(notes=("it is 2 by sound; choose another with --method",), record=lambda: record)

    monkeypatch.setattr(_run_footage, "sync", sync)
    again(clips, tmp_path / "dance", say=said.append)
    assert any(sentence.endswith("; by sound.") for sentence in said)
    assert any(f"another with jaxmocap sync {tmp_path / 'dance' / 'capture'} --method" in one for one in said)
    assert "Warning: up is only guessed." in said


def test_where_nothing_else_tells_the_time_keypoints_are_asked(clips, done, tmp_path, monkeypatch):
    def bad(*_, **__):
        raise InputError("right cannot be synchronised with left")

    monkeypatch.setattr(_run_footage, "sync", bad)
    monkeypatch.setattr(_run_footage, "sync_by_person", lambda folder: None)
    with pytest.raises(InputError, match=r"stage 'synchronise' failed: right cannot be .* --offset right_hand=SECONDS"):
        again(clips, tmp_path / "dance")
    said: list[str] = []

    def sure(folder):
        file = config_path(folder)
        file.write_text(with_offsets(file.read_text(), [0.0, -0.04], file))
        return [PersonOffset(-0.04, 0.95, 0.5)]

    monkeypatch.setattr(_run_footage, "sync_by_person", sure)
    result = run(clips, tmp_path / "dance", height=1.8, say=said.append)
    assert list(result.seconds) == STAGES[1:]
    assert any("Offsets in frames: +0.00, -1.2" in sentence and "likeness 0.95" in sentence for sentence in said)


def test_whoever_is_named_anew_is_looked_for_anew_before_the_time_is_asked_again(clips, done, tmp_path, monkeypatch):
    def bad(*_, **__):
        raise InputError("right cannot be synchronised with left")

    monkeypatch.setattr(_run_footage, "sync", bad)
    monkeypatch.setattr(_run_footage, "sync_by_person", lambda folder: None)
    for person, times in (({}, 1), ({}, 1), ({"left": (30.0, 40.0)}, 2), ({"left": (30.0, 40.0)}, 2)):
        with pytest.raises(InputError, match="stage 'synchronise' failed"):
            again(clips, tmp_path / "dance", person=person)
        assert done.count("detect") == times


def test_offsets_that_are_known_are_taken_and_others_are_not_looked_for(clips, done, tmp_path):
    def offsets() -> list[float]:
        return list(Capture.open(tmp_path / "dance" / "capture", with_cameras=False).offsets)

    _, names = again(clips, tmp_path / "dance", offset={"right_hand": -0.04})
    assert names == STAGES
    assert "synchronise" not in done
    assert offsets() == [0.0, -0.04]
    assert again(clips, tmp_path / "dance", offset={"right_hand": -0.04})[1] == []
    _, names = again(clips, tmp_path / "dance", offset={"right_hand": 0.04})
    assert names[0] == "synchronise"
    assert offsets() == [0.0, 0.04]
    again(clips, tmp_path / "dance")
    assert done.count("synchronise") == 1
    assert offsets() == [0.0, 0.0]


def test_offsets_that_the_person_corrects_are_no_change_by_hand(clips, done, tmp_path, monkeypatch):
    stand_in, kept = _run_footage.calibrate_folder, []

    def calibrate(folder, say, **options):
        stand_in(folder, say, **options)
        kept.append(options["keep_offsets"])
        file = config_path(folder)
        if not options["keep_offsets"]:
            file.write_text(with_offsets(file.read_text(), [0.0, -0.02], file))

        return SimpleNamespace(record={"warnings": []})

    monkeypatch.setattr(_run_footage, "calibrate_folder", calibrate)
    assert again(clips, tmp_path / "dance")[1] == STAGES
    assert again(clips, tmp_path / "dance")[1] == []
    file = tmp_path / "dance" / "capture" / "capture.toml"
    file.write_text(file.read_text().replace("offset = -0.02", "offset = -0.03"))
    again(clips, tmp_path / "dance")
    again(clips, tmp_path / "dance", offset={"left": 0.01})
    assert kept == [False, True]
    assert "offset = -0.03" in file.read_text()
    again(clips, tmp_path / "other", offset={"left": 0.01})
    assert kept == [False, True, True]


def test_an_offset_with_which_nothing_is_shared_is_refused_at_once(clips, done, tmp_path):
    with pytest.raises(InputError, match=r"stage 'synchronise' failed: the videos share no moment"):
        again(clips, tmp_path / "dance", offset={"right_hand": -30})
    assert done == []
    assert again(clips, tmp_path / "dance", offset={"right_hand": 0.04})[1] == STAGES[1:]


def test_one_video_is_not_synchronised_and_has_a_camera_that_stands_still(clips, done, tmp_path):
    said: list[str] = []
    run(clips[:1], tmp_path / "dance", height=1.8, focal={"left": 70.0}, say=said.append)
    assert done == ["detect", "body", "selected frames", "track"]
    assert any("One view: the camera is taken to stand still" in sentence for sentence in said)
    opened = Capture.open(tmp_path / "dance" / "capture")
    found = read_cameras(
        tmp_path / "dance" / "capture" / "cameras", ("left",), 12, [(64, 48)], opened.video_frames, 1.0
    )
    np.testing.assert_allclose(found.intrinsics[0], [[70, 0, 32], [0, 70, 24], [0, 0, 1]])
    seen = np.asarray(found.cam_from_world[0, 11]) @ [0, 1, -3, 1]  # above and ahead
    np.testing.assert_allclose(seen, [0, -1, 3, 1], atol=1e-6)
