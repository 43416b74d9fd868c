"""What a second run does again, what it keeps, and how it goes on where one was cut off."""

import shutil
import tomllib

import pytest
from stand_ins import STAGES, again

from jaxmocap._results import InputError
from jaxmocap.capture import Capture, config_path, with_lines
from jaxmocap.pipeline import _run_folder, _run_footage, _run_work, run
from jaxmocap.pipeline._made_to_measure import MadeBody
from jaxmocap.rigging import body


def test_how_pictures_are_read_is_an_input_of_what_is_made_of_them(clips, done, tmp_path):
    out = tmp_path / "dance"
    again(clips, out)
    file = out / "capture" / "capture.toml"
    file.write_text("longest_side = 720\n" + file.read_text())
    assert again(clips, out)[1] == ["body", "selected frames", "track"]
    file.write_text("frames = 10\n" + file.read_text())
    assert again(clips, out)[1] == STAGES[2:]


def test_a_run_that_cannot_be_gone_on_with_begins_a_new_result(clips, done, tmp_path, monkeypatch):
    """Another version, or another machine, would not come to the same bits."""
    out, good = tmp_path / "dance", _run_work.track_capture

    def cut_off(folder, out, **options):
        out.mkdir()
        (out / "half").write_text("")
        raise KeyboardInterrupt

    monkeypatch.setattr(_run_work, "track_capture", cut_off)
    with pytest.raises(KeyboardInterrupt):
        again(clips, out)
    monkeypatch.setattr(_run_work, "machine", lambda: "another")
    monkeypatch.setattr(_run_work, "track_capture", good)
    assert again(clips, out)[0].folder == out / "result-2"


def test_what_was_deleted_is_made_again(clips, done, tmp_path, monkeypatch):
    out = tmp_path / "dance"
    again(clips, out)
    (out / "capture" / "actor.glb").unlink()
    assert list(run(clips, out, height=1.8).seconds) == ["body"]  # the same as before
    shutil.rmtree(out / "capture" / "cameras")
    assert "calibrate" in run(clips, out, height=1.8).seconds
    shutil.rmtree(out / "capture" / "keypoints")
    assert "detect" in run(clips, out, height=1.8).seconds
    assert (out / "capture" / "keypoints" / "left.json").is_file()
    result = again(clips, out, seed=1)[0].folder
    shutil.rmtree(result)
    assert again(clips, out, seed=1)[1] == ["track"]
    (result / "motion.npz").unlink()
    anew, names = again(clips, out, seed=1)
    assert (names, anew.folder != result) == (["track"], True)
    anew.report.unlink()
    monkeypatch.setattr(_run_work, "report_page", lambda folder, **_: folder / "new page")
    anew, names = again(clips, out, seed=1)
    assert (names, anew.report.name) == ([], "new page")


def test_a_run_that_is_cut_off_goes_on_whatever_it_was_doing(clips, done, tmp_path, monkeypatch):
    """What it wrote itself is not taken for a change by hand."""
    out, good = tmp_path / "dance", _run_footage.FootageWork._find_person
    with monkeypatch.context() as cut:
        cut.setattr(_run_footage.FootageWork, "hash_of", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            again(clips, out)
    assert (out / "run.json").is_file()
    calls: list[int] = []

    def second_time(work):
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return good(work)

    with monkeypatch.context() as cut:
        cut.setattr(_run_footage.FootageWork, "_find_person", second_time)
        with pytest.raises(KeyboardInterrupt):
            again(clips, out)
    said: list[str] = []
    assert "calibrate" in again(clips, out, say=said.append)[1]
    assert not any("by hand" in sentence for sentence in said)


@pytest.mark.parametrize("when", ["before", "after"])
def test_cameras_of_a_run_that_is_killed_as_it_names_them_are_made_again(clips, done, tmp_path, monkeypatch, when):
    out, good = tmp_path / "dance", _run_footage.calibrate_folder
    again(clips, out)

    def killed(folder, say, naming, **options):
        if when == "after":
            good(folder, say, naming, **options)
        else:
            naming("cameras-2")
        raise KeyboardInterrupt

    with monkeypatch.context() as cut:
        cut.setattr(_run_footage, "calibrate_folder", killed)
        with pytest.raises(KeyboardInterrupt):
            again(clips, out, height=1.7)
    said: list[str] = []
    assert "calibrate" in again(clips, out, height=1.6, say=said.append)[1]
    assert not any("by hand" in sentence for sentence in said)
    named = tomllib.loads((out / "capture" / "capture.toml").read_text())["cameras"]
    assert (out / "capture" / named / "height").read_text() == "1.6"


def test_a_run_that_was_killed_in_its_first_stage_is_repeated_and_one_at_work_is_left_alone(clips, done, tmp_path):
    out = tmp_path / "dance"
    with _run_folder.only_run(out, out), pytest.raises(InputError, match="another run is writing to"):
        run(clips, out, height=1.8)
    (out / ".0123456789ab.partial.capture").mkdir(parents=True)
    (out / "lock").write_text("")
    assert again(clips, out)[1] == STAGES
    (out / "run.json").write_text("{")
    with pytest.raises(InputError, match=r"run\.json cannot be read .* or delete \S+dance and every stage"):
        run(clips, out, height=1.8)


def test_cameras_that_are_scaled_with_the_body_are_not_taken_for_a_change_by_hand(clips, done, monkeypatch, tmp_path):
    factors: list[float] = []

    def character_of(capture, **options):
        return MadeBody(body(options["height"]), camera_scale=0.97 if options["scale_cameras"] else 1.0)

    def scale_in_place(folder, factor, naming, progress):
        factors.append(factor)
        scaled = shutil.copytree(folder / "cameras", folder / "cameras-2")
        (scaled / "factor").write_text(str(factor))
        file = config_path(folder)
        naming("cameras-2")
        file.write_text(with_lines(file.read_text(), {"cameras": "cameras-2"}, file))
        return scaled

    monkeypatch.setattr(_run_work, "character_of", character_of)
    monkeypatch.setattr(_run_work, "scale_in_place", scale_in_place)
    out, said = tmp_path / "dance", []
    assert again(clips, out, say=said.append)[1] == STAGES
    assert factors == [0.97]
    assert any("multiplied by 0.970" in sentence for sentence in said)
    said.clear()
    assert again(clips, out, say=said.append)[1] == []
    assert not any("by hand" in sentence for sentence in said)
    toml = out / "capture" / "capture.toml"
    toml.write_text(toml.read_text().replace('"cameras-2"', '"cameras"'))
    assert "body" in again(clips, out)[1]
    assert factors == [0.97]  # nor are cameras that somebody chose scaled
    again(clips, tmp_path / "measured", camera_distance=2.0)
    assert factors == [0.97]  # a distance that was measured stands


def test_what_is_corrected_by_hand_counts_and_is_kept(clips, done, tmp_path):
    out = tmp_path / "dance"
    again(clips, out)
    file = out / "capture" / "capture.toml"
    file.write_text(file.read_text().replace("selected_frames = [0, 2]", "selected_frames = [1]"))
    assert again(clips, out)[1] == ["track"]
    assert again(clips, out, height=1.7)[1] == ["calibrate", "body", "track"]
    assert "selected_frames = [1]" in file.read_text()
    (out / "capture" / "keypoints" / "left.json").write_text("[[1, 2, 3]]")
    assert again(clips, out, height=1.7)[1] == ["calibrate", "body", "track"]
    assert (out / "capture" / "keypoints" / "left.json").read_text() == "[[1, 2, 3]]"


def test_it_goes_on_from_the_first_stage_whose_inputs_changed(clips, done, tmp_path):
    out = tmp_path / "dance"
    again(clips, out)
    result, names = again(clips, out, quality="draft")
    assert names == ["track"]
    assert result.folder == out / "result-2"  # an earlier result is never overwritten
    assert again(clips, out, quality="draft", height=1.7)[1] == STAGES[3:]
    assert (out / "capture" / "cameras").is_dir()  # and earlier cameras neither
    assert Capture.open(out / "capture").actor == out / "capture" / "actor-2.glb"
    person = {"left": (3.0, 4.0)}
    assert again(clips, out, quality="draft", height=1.7, person=person)[1] == STAGES[2:]


def test_a_stage_that_fails_is_named_and_what_was_done_stays(clips, done, tmp_path, monkeypatch):
    out, good = tmp_path / "dance", _run_footage.calibrate_folder

    def bad(*_, **__):
        raise InputError("camera 'left' shares no background with the others.")

    monkeypatch.setattr(_run_footage, "calibrate_folder", bad)
    with pytest.raises(InputError, match=r"stage 'calibrate' failed: camera 'left' .* others\. What you can do: "):
        again(clips, out)
    assert done == ["synchronise", "detect"]
    assert not list(tmp_path.glob("**/*.partial*"))
    monkeypatch.setattr(_run_footage, "calibrate_folder", good)
    assert again(clips, out)[1] == STAGES[3:]


def test_other_frames_calibrate_again_only_where_a_camera_is_lost_in_them(clips, tmp_path, done):
    """The right camera is lost from frame 6 on."""
    out = tmp_path / "dance"
    run(clips, out, height=1.8, frames=(0, 4))
    assert again(clips, out, frames=(0, 6))[1] == ["body", "selected frames", "track"]
    assert "calibrate" in run(clips, out, height=1.8, frames=(0, 12)).seconds
