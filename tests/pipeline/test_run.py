"""One command from videos to a motion: the plan, what is done again, what is kept, and what is refused.

The stages themselves have tests of their own; here stand-ins write what they would.
"""

import json
import shutil
import tomllib
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from small_captures import make_video

from jaxmocap._cli import run as command
from jaxmocap._results import InputError
from jaxmocap.camera import read_cameras
from jaxmocap.capture import Capture, PersonOffset, config_path, with_lines, with_offsets
from jaxmocap.character import Character, Pose, stature
from jaxmocap.detection import Weights, _weights
from jaxmocap.motion import Motion
from jaxmocap.pipeline import RunResult, _run_files, _run_folder, _run_footage, _run_work, run
from jaxmocap.pipeline._made_to_measure import MadeBody
from jaxmocap.rigging import body

PERSON = [20.0, 20.0, 0.9] * 25
PICTURE = json.dumps({"people": [{"pose_keypoints_2d": PERSON}]})
VIDEO = json.dumps([{"frame_id": 1, "instances": [{"keypoints": [[20, 20]] * 17, "keypoint_scores": [0.9] * 17}]}])
STAGES = ["capture", "synchronise", "detect", "calibrate", "body", "selected frames", "track"]


@pytest.fixture(scope="module")
def videos(tmp_path_factory) -> list[Path]:
    """Two small videos, one upright and one lying; nobody is in them."""
    folder = tmp_path_factory.mktemp("videos")
    return [make_video(folder / "left.mp4"), make_video(folder / "right hand.mp4", size=(48, 64))]


@pytest.fixture(scope="module")
def motion() -> Motion:
    character = body()
    poses = Pose(jnp.stack([jnp.eye(4)] * 2), jnp.zeros((2, character.skeleton.num_angles)))
    provenance = {"lost": [], "outlier_cameras": [], "doubts": [], "seconds_per_frame": 1.0}
    return Motion.from_poses(character, poses, np.arange(2), np.array([0.0, 0.04]), provenance=provenance)


@pytest.fixture
def done(monkeypatch, motion) -> list[str]:
    """The stages that are done, in order; each stand-in writes into the capture folder what its stage would."""
    names: list[str] = []

    def set_lines(folder: Path, **lines) -> None:
        file = config_path(folder)
        file.write_text(with_lines(file.read_text(), lines, file))

    def sync(folder, progress):
        names.append("synchronise")
        file = config_path(folder)
        file.write_text(with_offsets(file.read_text(), [0.0] * file.read_text().count("[[camera]]"), file))
        record = {"cameras": {"left": {"offset_frames": 0.0}}, "pairs": [{"used": "sound"}]}
        return SimpleNamespace(notes=("the sound says so",), record=lambda: record)

    def detect(folder, **options):
        names.append("detect")
        (folder / "keypoints").mkdir(exist_ok=True)
        (folder / "keypoints" / "left.json").write_text(json.dumps(sorted(options["person"].items())))
        (folder / "detection.json").write_text("{}")
        set_lines(folder, keypoints="keypoints")
        return SimpleNamespace(folder=folder / "keypoints")

    def calibrate(folder, say, naming, **options):
        names.append("calibrate")
        cameras = _run_footage.free_name(folder, "cameras")
        cameras.mkdir()
        (cameras / "height").write_text(str(options["height"]))
        (cameras / "static").write_text(str(options["static"]))
        lost = {"left": {"interpolated": []}, "right_hand": {"interpolated": list(range(6, 12))}}
        scale = {"from": "height" if options["camera_distance"] is None else "camera distance"}
        (cameras / "calibration.json").write_text(json.dumps({"cameras": lost, "scale": scale}))
        naming(cameras.name)
        set_lines(folder, cameras=cameras.name)
        return SimpleNamespace(record={"warnings": ["up is only guessed"]})

    def character_of(capture, **options):
        names.append("body")
        return MadeBody(body(options["height"]))

    def scan(video, **options):
        names.append("scan")
        return SimpleNamespace(rigged=SimpleNamespace(character=body(options["height"])), colours=None)

    def select(capture, within):
        names.append("selected frames")
        first = int(capture.video_frames[0, 0])
        return capture, {"frames": [first, first + 2], "reason": "they are good"}

    def track_capture(folder, out, **options):
        names.append("track")
        out.mkdir()
        motion.save(out)
        (out / "report.html").write_text("")
        return motion

    stand_ins = {
        "sync": sync, "detect": detect, "calibrate_folder": calibrate, "character_of": character_of,
        "with_selected_frames": select, "track_capture": track_capture, "scan": scan,
    }  # fmt: skip
    for name, stand_in in stand_ins.items():
        monkeypatch.setattr(_run_work if hasattr(_run_work, name) else _run_footage, name, stand_in)
    monkeypatch.setattr(_run_files, "require_runner", lambda: None)
    monkeypatch.setattr(_run_files, "get_weights", lambda *_, **__: None)
    monkeypatch.setattr(_run_footage, "refuse_views_of_different_people", lambda capture: None)
    opened = Capture.open
    monkeypatch.setattr(Capture, "open", staticmethod(lambda path, **_: opened(path, with_cameras=False)))
    return names


def again(videos, out, **options) -> tuple[RunResult, list[str]]:
    """Run; the result, and the stages that were done, which are those that the plan said."""
    planned: list[str] = []

    def note(stages) -> None:
        planned.extend(stage.name for stage in stages if stage.state in ("to do", "again"))

    result = run(videos, out, plan=note, **({"height": 1.8} | options))
    assert list(result.seconds) == planned
    return result, planned


def test_everything_is_done_once_and_then_read(videos, done, tmp_path):
    out = tmp_path / "dance"
    result, names = again(videos, out)
    assert names == STAGES
    assert list(dict.fromkeys(done)) == STAGES[1:]
    assert (result.capture, result.report) == (out / "capture", out / "result" / "report.html")
    assert len(result.motion) == 2
    text = (out / "capture" / "capture.toml").read_text()
    assert 'name = "dance"' in text
    assert 'video = "right_hand.mp4"' in text
    for line in (
        "offset = 0.0",
        'keypoints = "keypoints"',
        'cameras = "cameras"',
        'actor = "actor.glb"',
        "selected_frames = [0, 2]",
    ):
        assert line in text
    opened = Capture.open(out / "capture")
    assert opened.sizes == ((64, 48), (48, 64))
    done.clear()
    result, names = again(videos, out)
    assert (names, done) == ([], [])
    assert len(result.motion) == 2


def test_it_goes_on_from_the_first_stage_whose_inputs_changed(videos, done, tmp_path):
    out = tmp_path / "dance"
    again(videos, out)
    result, names = again(videos, out, quality="draft")
    assert names == ["track"]
    assert result.folder == out / "result-2"  # an earlier result is never overwritten
    assert again(videos, out, quality="draft", height=1.7)[1] == STAGES[3:]
    assert (out / "capture" / "cameras").is_dir()  # and earlier cameras neither
    assert Capture.open(out / "capture").actor == out / "capture" / "actor-2.glb"
    person = {"left": (3.0, 4.0)}
    assert again(videos, out, quality="draft", height=1.7, person=person)[1] == STAGES[2:]


def test_cameras_that_are_scaled_with_the_body_are_not_taken_for_a_change_by_hand(videos, done, monkeypatch, tmp_path):
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
    assert again(videos, out, say=said.append)[1] == STAGES
    assert factors == [0.97]
    assert any("multiplied by 0.970" in sentence for sentence in said)
    said.clear()
    assert again(videos, out, say=said.append)[1] == []
    assert not any("by hand" in sentence for sentence in said)
    toml = out / "capture" / "capture.toml"
    toml.write_text(toml.read_text().replace('"cameras-2"', '"cameras"'))
    assert "body" in again(videos, out)[1]
    assert factors == [0.97]  # nor are cameras that somebody chose scaled
    again(videos, tmp_path / "measured", camera_distance=2.0)
    assert factors == [0.97]  # a distance that was measured stands


def test_what_is_corrected_by_hand_counts_and_is_kept(videos, done, tmp_path):
    out = tmp_path / "dance"
    again(videos, out)
    file = out / "capture" / "capture.toml"
    file.write_text(file.read_text().replace("selected_frames = [0, 2]", "selected_frames = [1]"))
    assert again(videos, out)[1] == ["track"]
    assert again(videos, out, height=1.7)[1] == ["calibrate", "body", "track"]
    assert "selected_frames = [1]" in file.read_text()
    (out / "capture" / "keypoints" / "left.json").write_text("[[1, 2, 3]]")
    assert again(videos, out, height=1.7)[1] == ["calibrate", "body", "track"]
    assert (out / "capture" / "keypoints" / "left.json").read_text() == "[[1, 2, 3]]"


def test_a_stage_that_fails_is_named_and_what_was_done_stays(videos, done, tmp_path, monkeypatch):
    out, good = tmp_path / "dance", _run_footage.calibrate_folder

    def bad(*_, **__):
        raise InputError("camera 'left' shares no background with the others.")

    monkeypatch.setattr(_run_footage, "calibrate_folder", bad)
    with pytest.raises(InputError, match=r"stage 'calibrate' failed: camera 'left' .* others\. What you can do: "):
        again(videos, out)
    assert done == ["synchronise", "detect"]
    assert not list(tmp_path.glob("**/*.partial*"))
    monkeypatch.setattr(_run_footage, "calibrate_folder", good)
    assert again(videos, out)[1] == STAGES[3:]


def test_a_body_that_was_made_of_other_keypoints_does_not_tell_the_scale_of_new_cameras(
    videos, done, tmp_path, monkeypatch
):
    """Nor do the cameras of before say which new keypoints are right; what was set by hand does."""
    out, seen = tmp_path / "dance", []
    toml = out / "capture" / "capture.toml"

    def noting(module, name):
        stand_in = getattr(module, name)

        def noted(folder, *told, **options):
            text = toml.read_text()
            seen.append((name.removesuffix("_folder"), "actor =" in text, "cameras =" in text))
            return stand_in(folder, *told, **options)

        monkeypatch.setattr(module, name, noted)

    noting(_run_footage, "detect")
    noting(_run_footage, "calibrate_folder")
    first = [("detect", False, False), ("calibrate", False, False)]
    after = ("detect", False, True)  # views are held against each other with the cameras just found
    again(videos, out)
    assert seen == [*first, after]
    seen.clear()
    assert again(videos, out, person={"left": (3.0, 4.0)})[1] == STAGES[2:]
    assert seen == [*first, after]
    seen.clear()
    shutil.copy(out / "capture" / "actor.glb", out / "capture" / "mine.glb")
    toml.write_text(toml.read_text().replace("actor-2.glb", "mine.glb"))
    again(videos, out, person={"left": (5.0, 4.0)})
    assert [actor for _, actor, _ in seen] == [True, True, True]


def test_an_offset_with_which_nothing_is_shared_is_refused_at_once(videos, done, tmp_path):
    with pytest.raises(InputError, match=r"stage 'synchronise' failed: the videos share no moment"):
        again(videos, tmp_path / "dance", offset={"right_hand": -30})
    assert done == []
    assert again(videos, tmp_path / "dance", offset={"right_hand": 0.04})[1] == STAGES[1:]


def test_frames_that_are_not_shared_are_refused_before_anybody_is_looked_for(videos, done, tmp_path):
    told = {"offset": {"right_hand": 0.2}, "frames": (0, 12)}
    for _ in range(2):
        with pytest.raises(
            InputError, match=r"frames 0:12 were asked for, but the videos share \d frames, .* --frames"
        ):
            run(videos, tmp_path / "dance", height=1.8, **told)
    assert done == []


def test_a_pair_that_nothing_ties_directly_is_no_obstacle(videos, done, tmp_path, monkeypatch):
    stand_in, said = _run_footage.sync, []

    def sync(folder, progress):
        record = stand_in(folder, progress).record() | {"pairs": [{"used": "sound"}, {"used": None}]}
        return SimpleNamespace(notes=("it is 2 by sound; choose another with --method",), record=lambda: record)

    monkeypatch.setattr(_run_footage, "sync", sync)
    again(videos, tmp_path / "dance", say=said.append)
    assert any(sentence.endswith("; by sound.") for sentence in said)
    assert any(f"another with jaxmocap sync {tmp_path / 'dance' / 'capture'} --method" in one for one in said)
    assert "Warning: up is only guessed." in said


def test_keypoints_that_were_given_once_are_left_again(videos, done, tmp_path):
    out, given = tmp_path / "dance", tmp_path / "given"
    given.mkdir()
    (given / "left.json").write_text(VIDEO)
    (given / "right_hand.json").write_text(VIDEO)
    again(videos, out)
    again(videos, out, keypoints=given)
    assert Capture.open(out / "capture").keypoints_folder == out / "capture" / "keypoints-2"
    assert again(videos, out)[1][0] == "detect"
    assert Capture.open(out / "capture").keypoints_folder == out / "capture" / "keypoints"


def test_keypoints_that_are_named_like_the_video_are_named_like_its_camera(videos, done, tmp_path):
    given = tmp_path / "given"
    (given / "right hand_json").mkdir(parents=True)
    (given / "right hand_json" / "right hand_00003.json").write_text(PICTURE)
    again(videos[1:], tmp_path / "alone", keypoints=given)
    with pytest.raises(InputError, match=r"--keypoints .*given has no file for camera 'left', .* left\.json"):
        again(videos, tmp_path / "dance", keypoints=given)
    assert not (tmp_path / "dance").exists()
    (given / "left_000000000003_keypoints.json").write_text(PICTURE)
    again(videos, tmp_path / "dance", keypoints=given)
    opened = Capture.open(tmp_path / "dance" / "capture")
    assert [opened.keypoint_frames(camera) for camera in range(2)] == [(3,), (3,)]
    same = [
        shutil.copy(video, make_folder(tmp_path / name) / "x.mp4") for name, video in zip("ab", videos, strict=True)
    ]
    (given / "x.json").write_text(VIDEO)
    with pytest.raises(InputError, match=r"no file for camera 'cam0', .*a/x\.mp4; cam0_00000_keypoints\.json"):
        again(same, tmp_path / "other", keypoints=given)


@pytest.mark.parametrize("name", ["predictions/right hand.json", "results_right hand.json", "right hand.json"])
def test_a_file_of_a_whole_video_that_is_named_like_it_is_found_in_the_capture(name, videos, done, tmp_path):
    file = tmp_path / "given" / name
    file.parent.mkdir(parents=True)
    file.write_text(VIDEO)
    again(videos[1:], tmp_path / "alone", keypoints=tmp_path / "given")
    assert Capture.open(tmp_path / "alone" / "capture").keypoint_frames(0) == (1,)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("no JSON", r"keypoints .*left\.json is not JSON"),
        (VIDEO.replace("0.9, ", "", 1), r"keypoints .*left\.json is not an OpenPose file"),
        (
            json.dumps([{"frame_id": 1, "instances": [{"keypoints": [[2, 2]] * 18, "keypoint_scores": [0.9] * 18}]}]),
            r"keypoints .*left\.json: a person has 18 points, which looks like COCO \(18 points\); expected",
        ),
        (
            json.dumps([{"frame_id": 1, "instances": []}]),
            r"--keypoints \S+ show nobody in the 12 pictures of camera 'left'",
        ),
        (VIDEO.replace('"frame_id": 1', '"frame_id": 100').replace("[{", '[{"frame_id": 0, "instances": []}, {', 1),
         r"--keypoints \S+ show nobody in the 12 pictures of camera 'left'"),
        (VIDEO.replace("[20, 20]", "[200, 20]"), r"camera 'left' lie as far as 200, 20, outside the 64 x 48 pixels"),
    ],
)  # fmt: skip
def test_keypoints_that_are_none_are_refused_before_anything_is_done(content, words, videos, done, tmp_path, capsys):
    given, out = make_folder(tmp_path / "given"), tmp_path / "dance"
    (given / "right_hand.json").write_text(VIDEO)
    (given / "left.json").write_text(content)
    with pytest.raises(InputError, match=words):
        run(videos, out, height=1.8, keypoints=given)
    assert command(["run", *map(str, videos), "--height", "1.8", "--out", str(out), "--keypoints", str(given)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert (done, out.exists()) == ([], False)


def test_the_layout_that_the_capture_names_holds_for_keypoints_that_are_given_to_it(videos, done, tmp_path):
    given, out = make_folder(tmp_path / "given"), tmp_path / "dance"
    points = {"keypoints": [[20, 20]] * 30, "keypoint_scores": [0.9] * 30}  # COCO's, and others of a program's own
    for name in ("left", "right_hand"):
        (given / f"{name}.json").write_text(json.dumps([{"frame_id": 1, "instances": [points]}]))
    again(videos, out)
    with pytest.raises(InputError, match="a person has 30 points"):
        again(videos, out, keypoints=given)
    file = out / "capture" / "capture.toml"
    file.write_text('keypoint_layout = "coco17"\n' + file.read_text())
    assert "detect" in again(videos, out, keypoints=given)[1]


@pytest.fixture
def real_weights(monkeypatch):
    """Weights are looked for as ever, but not downloaded."""
    monkeypatch.setattr(_run_files, "get_weights", _weights.get_weights)
    monkeypatch.setattr(_weights.shutil, "which", lambda name: None)
    monkeypatch.setattr(_weights.subprocess, "run", lambda *_, **__: SimpleNamespace(returncode=1, stderr="no network"))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path: path.write_text("mine"), r"weights \S+ are no model: neither a folder nor an archive"),
        (lambda path: path.mkdir(), r"weights \S+ do not hold BlazePose GHUM heavy: found none of its files"),
        (
            lambda path: (make_folder(path) / "pose_landmark_heavy.tflite").write_bytes(b"cut off"),
            r"pose_landmark_heavy\.tflite in \S+ is not the file of BlazePose GHUM heavy: its SHA-256 is",
        ),
    ],
)
def test_weights_that_are_none_are_refused_before_anything_is_done(
    make, words, videos, done, real_weights, tmp_path, capsys
):
    make(tmp_path / "weights")
    out, weights = tmp_path / "dance", tmp_path / "weights"
    with pytest.raises(InputError, match=words):
        run(videos, out, height=1.8, weights=weights)
    assert command(["run", *map(str, videos), "--height", "1.8", "--out", str(out), "--weights", str(weights)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert (done, out.exists()) == ([], False)


def test_a_bundle_of_other_networks_is_refused_before_anything_is_done(videos, done, monkeypatch, tmp_path):
    pytest.importorskip("ai_edge_litert", reason="the extra 'detect' is not installed")
    given = Weights("heavy", {"person": b"no network", "landmarks": b"no network"})
    monkeypatch.setattr(_run_files, "get_weights", lambda *_: given)
    with pytest.raises(InputError, match="the person detector of BlazePose GHUM heavy is no network of TensorFlow Li"):
        run(videos, tmp_path / "dance", height=1.8, weights=tmp_path)
    assert done == []


def test_without_weights_and_network_nothing_is_begun_and_without_need_of_them_all_is(
    videos, done, real_weights, monkeypatch, tmp_path
):
    monkeypatch.setattr(_weights, "cache_folder", lambda name: tmp_path / "cache" / name)
    out, given = tmp_path / "dance", make_folder(tmp_path / "given")
    with pytest.raises(InputError, match=r"the weights of BlazePose GHUM heavy .* could not be downloaded"):
        run(videos, out, height=1.8)
    assert (done, out.exists()) == ([], False)
    for name in ("left", "right_hand"):
        (given / f"{name}.json").write_text(VIDEO)
    assert again(videos, out, keypoints=given)[1] == STAGES
    assert again(videos, out, keypoints=given)[1] == []
    with pytest.raises(InputError, match="could not be downloaded"):
        run(videos, tmp_path / "other", height=1.8, keypoints=given, scan=make_video(tmp_path / "walk.mp4"))
    (tmp_path / "views").mkdir()
    (tmp_path / "views" / "views.json").write_text("{}")  # with masks, so that nobody is looked for
    assert again(videos, tmp_path / "third", keypoints=given, scan=tmp_path / "views")[1][-1] == STAGES[-1]


@pytest.mark.parametrize(
    ("option", "name", "words"),
    [
        ("actor", "me.obj", r"me\.obj cannot be read as a mesh|me\.obj holds no triangles"),
        ("actor", "me.glb", r"me\.glb"),
        ("actor", "me.txt", r"me\.txt is not a known kind of mesh"),
        ("scan", "walk.mp4", r"walk\.mp4"),
    ],
)
def test_an_actor_or_a_scan_that_is_none_is_refused_before_anything_is_done(
    option, name, words, videos, done, tmp_path
):
    (tmp_path / name).write_text("mine")
    with pytest.raises(InputError, match=words):
        run(videos, tmp_path / "dance", **{"height": 1.8, option: tmp_path / name})
    assert (done, (tmp_path / "dance").exists()) == ([], False)
    (tmp_path / "pictures").mkdir()
    with pytest.raises(InputError, match="pictures holds no pictures"):
        run(videos, tmp_path / "dance", height=1.8, scan=tmp_path / "pictures")


def make_folder(folder: Path) -> Path:
    folder.mkdir()
    return folder


def test_how_pictures_are_read_is_an_input_of_what_is_made_of_them(videos, done, tmp_path):
    out = tmp_path / "dance"
    again(videos, out)
    file = out / "capture" / "capture.toml"
    file.write_text("longest_side = 720\n" + file.read_text())
    assert again(videos, out)[1] == ["body", "selected frames", "track"]
    file.write_text("frames = 10\n" + file.read_text())
    assert again(videos, out)[1] == STAGES[2:]


def test_a_run_that_cannot_be_gone_on_with_begins_a_new_result(videos, done, tmp_path, monkeypatch):
    """Another version, or another machine, would not come to the same bits."""
    out, good = tmp_path / "dance", _run_work.track_capture

    def cut_off(folder, out, **options):
        out.mkdir()
        (out / "half").write_text("")
        raise KeyboardInterrupt

    monkeypatch.setattr(_run_work, "track_capture", cut_off)
    with pytest.raises(KeyboardInterrupt):
        again(videos, out)
    monkeypatch.setattr(_run_work, "machine", lambda: "another")
    monkeypatch.setattr(_run_work, "track_capture", good)
    assert again(videos, out)[0].folder == out / "result-2"


def test_what_was_deleted_is_made_again(videos, done, tmp_path, monkeypatch):
    out = tmp_path / "dance"
    again(videos, out)
    (out / "capture" / "actor.glb").unlink()
    assert list(run(videos, out, height=1.8).seconds) == ["body"]  # the same as before
    shutil.rmtree(out / "capture" / "cameras")
    assert "calibrate" in run(videos, out, height=1.8).seconds
    shutil.rmtree(out / "capture" / "keypoints")
    assert "detect" in run(videos, out, height=1.8).seconds
    assert (out / "capture" / "keypoints" / "left.json").is_file()
    result = again(videos, out, seed=1)[0].folder
    shutil.rmtree(result)
    assert again(videos, out, seed=1)[1] == ["track"]
    (result / "motion.npz").unlink()
    anew, names = again(videos, out, seed=1)
    assert (names, anew.folder != result) == (["track"], True)
    anew.report.unlink()
    monkeypatch.setattr(_run_work, "report_page", lambda folder, **_: folder / "new page")
    anew, names = again(videos, out, seed=1)
    assert (names, anew.report.name) == ([], "new page")


def test_a_run_that_is_cut_off_goes_on_whatever_it_was_doing(videos, done, tmp_path, monkeypatch):
    """What it wrote itself is not taken for a change by hand."""
    out, good = tmp_path / "dance", _run_footage.FootageWork._find_person
    with monkeypatch.context() as cut:
        cut.setattr(_run_footage.FootageWork, "hash_of", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            again(videos, out)
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
            again(videos, out)
    said: list[str] = []
    assert "calibrate" in again(videos, out, say=said.append)[1]
    assert not any("by hand" in sentence for sentence in said)


@pytest.mark.parametrize("when", ["before", "after"])
def test_cameras_of_a_run_that_is_killed_as_it_names_them_are_made_again(videos, done, tmp_path, monkeypatch, when):
    out, good = tmp_path / "dance", _run_footage.calibrate_folder
    again(videos, out)

    def killed(folder, say, naming, **options):
        if when == "after":
            good(folder, say, naming, **options)
        else:
            naming("cameras-2")
        raise KeyboardInterrupt

    with monkeypatch.context() as cut:
        cut.setattr(_run_footage, "calibrate_folder", killed)
        with pytest.raises(KeyboardInterrupt):
            again(videos, out, height=1.7)
    said: list[str] = []
    assert "calibrate" in again(videos, out, height=1.6, say=said.append)[1]
    assert not any("by hand" in sentence for sentence in said)
    named = tomllib.loads((out / "capture" / "capture.toml").read_text())["cameras"]
    assert (out / "capture" / named / "height").read_text() == "1.6"


def test_where_nothing_else_tells_the_time_keypoints_are_asked(videos, done, tmp_path, monkeypatch):
    def bad(*_, **__):
        raise InputError("right cannot be synchronised with left")

    monkeypatch.setattr(_run_footage, "sync", bad)
    monkeypatch.setattr(_run_footage, "sync_by_person", lambda folder: None)
    with pytest.raises(InputError, match=r"stage 'synchronise' failed: right cannot be .* --offset right_hand=SECONDS"):
        again(videos, tmp_path / "dance")
    said: list[str] = []

    def sure(folder):
        file = config_path(folder)
        file.write_text(with_offsets(file.read_text(), [0.0, -0.04], file))
        return [PersonOffset(-0.04, 0.95, 0.5)]

    monkeypatch.setattr(_run_footage, "sync_by_person", sure)
    result = run(videos, tmp_path / "dance", height=1.8, say=said.append)
    assert list(result.seconds) == STAGES[1:]
    assert any("Offsets in frames: +0.00, -1.2" in sentence and "likeness 0.95" in sentence for sentence in said)


def test_whoever_is_named_anew_is_looked_for_anew_before_the_time_is_asked_again(videos, done, tmp_path, monkeypatch):
    def bad(*_, **__):
        raise InputError("right cannot be synchronised with left")

    monkeypatch.setattr(_run_footage, "sync", bad)
    monkeypatch.setattr(_run_footage, "sync_by_person", lambda folder: None)
    for person, times in (({}, 1), ({}, 1), ({"left": (30.0, 40.0)}, 2), ({"left": (30.0, 40.0)}, 2)):
        with pytest.raises(InputError, match="stage 'synchronise' failed"):
            again(videos, tmp_path / "dance", person=person)
        assert done.count("detect") == times


def test_offsets_that_are_known_are_taken_and_others_are_not_looked_for(videos, done, tmp_path):
    def offsets() -> list[float]:
        return list(Capture.open(tmp_path / "dance" / "capture", with_cameras=False).offsets)

    _, names = again(videos, tmp_path / "dance", offset={"right_hand": -0.04})
    assert names == STAGES
    assert "synchronise" not in done
    assert offsets() == [0.0, -0.04]
    assert again(videos, tmp_path / "dance", offset={"right_hand": -0.04})[1] == []
    _, names = again(videos, tmp_path / "dance", offset={"right_hand": 0.04})
    assert names[0] == "synchronise"
    assert offsets() == [0.0, 0.04]
    again(videos, tmp_path / "dance")
    assert done.count("synchronise") == 1
    assert offsets() == [0.0, 0.0]


def test_offsets_that_the_person_corrects_are_no_change_by_hand(videos, done, tmp_path, monkeypatch):
    stand_in, kept = _run_footage.calibrate_folder, []

    def calibrate(folder, say, **options):
        stand_in(folder, say, **options)
        kept.append(options["keep_offsets"])
        file = config_path(folder)
        if not options["keep_offsets"]:
            file.write_text(with_offsets(file.read_text(), [0.0, -0.02], file))

        return SimpleNamespace(record={"warnings": []})

    monkeypatch.setattr(_run_footage, "calibrate_folder", calibrate)
    assert again(videos, tmp_path / "dance")[1] == STAGES
    assert again(videos, tmp_path / "dance")[1] == []
    file = tmp_path / "dance" / "capture" / "capture.toml"
    file.write_text(file.read_text().replace("offset = -0.02", "offset = -0.03"))
    again(videos, tmp_path / "dance")
    again(videos, tmp_path / "dance", offset={"left": 0.01})
    assert kept == [False, True]
    assert "offset = -0.03" in file.read_text()
    again(videos, tmp_path / "other", offset={"left": 0.01})
    assert kept == [False, True, True]


def test_an_actor_comes_first_for_its_bones_tell_the_scale(videos, done, tmp_path):
    actor = tmp_path / "me.glb"
    body(1.7).save_glb(actor)
    _, names = again(videos, tmp_path / "dance", actor=actor, height=None)
    assert names == ["capture", "synchronise", "body", "detect", "calibrate", "selected frames", "track"]
    assert "body" not in done
    assert (tmp_path / "dance" / "capture" / "actor.glb").read_bytes() == actor.read_bytes()


@pytest.mark.slow
def test_an_actor_becomes_as_tall_as_the_height_that_is_given(videos, done, tmp_path):
    """As tall as the world of the cameras, whose scale the height tells too."""
    out, actor, bare = tmp_path / "dance", tmp_path / "me.glb", tmp_path / "me.obj"
    body(1.7).save_glb(actor)
    said: list[str] = []
    again(videos, out, actor=actor, height=1.8, say=said.append)
    assert float(stature(Character.load(out / "capture" / "actor.glb"))) == pytest.approx(1.8, abs=1e-3)
    assert any("me.glb is 1.70 m tall, and was scaled to the 1.80 m" in sentence for sentence in said)
    run(videos, out, actor=actor, height=1.705)
    assert (out / "capture" / "actor-2.glb").read_bytes() == actor.read_bytes()
    character = body(1.8)
    trimesh.Trimesh(3.0 * np.asarray(character.vertices), np.asarray(character.faces)).export(bare)  # no metres
    run(videos, out, actor=bare, height=1.8)
    assert float(stature(Character.load(out / "capture" / "actor-3.glb"))) == pytest.approx(1.8, abs=0.01)


def test_a_walk_around_the_person_becomes_the_actor_and_is_made_again_when_it_changes(videos, done, tmp_path):
    walk = make_video(tmp_path / "walk.mp4")
    _, names = again(videos, tmp_path / "dance", scan=walk)
    assert names == ["capture", "synchronise", "body", "detect", "calibrate", "selected frames", "track"]
    assert "scan" in done
    assert "body" not in done
    assert again(videos, tmp_path / "dance", scan=walk)[1] == []
    make_video(walk, size=(48, 64))
    assert list(run(videos, tmp_path / "dance", height=1.8, scan=walk).seconds)[:2] == ["body", "calibrate"]


def test_one_video_is_not_synchronised_and_has_a_camera_that_stands_still(videos, done, tmp_path):
    said: list[str] = []
    run(videos[:1], tmp_path / "dance", height=1.8, focal={"left": 70.0}, say=said.append)
    assert done == ["detect", "body", "selected frames", "track"]
    assert any("One view: the camera is taken to stand still" in sentence for sentence in said)
    opened = Capture.open(tmp_path / "dance" / "capture")
    found = read_cameras(
        tmp_path / "dance" / "capture" / "cameras", ("left",), 12, [(64, 48)], opened.video_frames, 1.0
    )
    np.testing.assert_allclose(found.intrinsics[0], [[70, 0, 32], [0, 70, 24], [0, 0, 1]])
    seen = np.asarray(found.cam_from_world[0, 11]) @ [0, 1, -3, 1]  # above and ahead
    np.testing.assert_allclose(seen, [0, -1, 3, 1], atol=1e-6)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"height": 18}, "height is 18 m; 0.5 to 2.5 m was expected"),
        ({"height": None}, "videos alone do not tell .* --height METRES"),
        ({"actor": "nobody.obj"}, "--actor nobody.obj does not exist"),
        ({"keypoints": "nothing"}, "--keypoints nothing does not exist"),
        ({"offset": {"me": 0.5}}, "--offset names 'me'; the cameras are called like their videos: left, right_hand"),
        ({"offset": {"left": float("nan")}}, "--offset left=nan: a number of seconds was expected"),
        (
            {"focal": {"lefft": 900}},
            "--focal names 'lefft'; the cameras are called like their videos: left, right_hand",
        ),
        ({"focal": {"left": 900}}, "--focal leaves out right_hand"),
        ({"focal": {"left": -5, "right_hand": 900}}, "--focal left=-5: pixels were expected"),
        ({"person": {"me": (1, 2)}}, "--person names 'me'"),
        ({"person": {"right_hand": (50, 2)}}, "--person right_hand=50,2 lies outside the pictures of 48 x 64 pixels"),
        ({"camera_distance": -3}, "--camera-distance is -3; metres"),
        ({"camera_distance": 235}, "--camera-distance is 235; metres .*, 0.01 to 200"),
        ({"seed": -1}, "--seed is -1; a whole number from 0 to 2147483647 was expected"),
        ({"seed": 2**31}, "--seed is 2147483648; a whole number"),
        ({"quality": "fast"}, "--quality is 'fast'; one of draft, normal, paper was expected"),
        ({"scan": "nowhere.mp4"}, "--scan nowhere.mp4 does not exist"),
        ({"scan": "walk.mp4", "actor": "me.glb"}, "--scan and --actor are given"),
        ({"scan": "walk.mp4", "height": None, "camera_distance": 2.0}, "--scan does not tell how large the person is"),
    ],
)
def test_what_cannot_work_is_refused_before_anything_is_done(options, words, videos, done, tmp_path):
    with pytest.raises(InputError, match=words):
        run(videos, tmp_path / "dance", **({"height": 1.8} | options))
    assert list(tmp_path.iterdir()) == []


def test_videos_that_cannot_be_used_are_refused(videos, done, tmp_path):
    broken = tmp_path / "broken.mp4"
    broken.write_bytes(videos[0].read_bytes()[:300])
    for given, words in (
        ([], "no video is given"),
        ([videos[0], broken], "broken.mp4"),
        ([videos[0], tmp_path / "gone.mp4"], "gone.mp4"),
        ([videos[0], videos[0]], "given twice"),
        ([videos[0], shutil.copy(videos[0], tmp_path / "copy.mp4")], r"left\.mp4 and .*copy\.mp4 are the same film"),
        (videos[0].with_name("lone.mp4"), r"lone\.mp4 does not exist"),
        (str(videos[0].with_name("lone.mp4")), r"lone\.mp4 does not exist"),
        ([tmp_path], "is a folder; the file of a video was expected"),
        ([videos[0], make_video(tmp_path / "photo.mp4", 1)], r"photo\.mp4 holds one picture"),
    ):
        with pytest.raises(InputError, match=words):
            run(given, tmp_path / "dance", height=1.8)
    assert not (tmp_path / "dance").exists()


def test_folders_of_others_and_of_other_videos_are_left_alone(videos, done, tmp_path):
    file = tmp_path / "file"
    file.write_text("mine")
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.txt").write_text("mine")
    with pytest.raises(InputError, match="is a file; a folder"):
        run(videos, file, height=1.8)
    with pytest.raises(InputError, match="holds files that no run wrote"):
        run(videos, foreign, height=1.8)
    assert [path.name for path in foreign.iterdir()] == ["thesis.txt"]
    out = tmp_path / "dance"
    out.mkdir()
    (out / ".DS_Store").write_text("a file manager's")
    again(videos, out)
    with pytest.raises(InputError, match="holds a run of other videos"):
        run(videos[:1], out, height=1.8)
    with pytest.raises(InputError, match=r"the same videos in another order; .* left, right_hand"):
        run(videos[::-1], out, height=1.8)
    assert (out / "result" / "motion.npz").is_file()


def test_a_run_that_was_killed_in_its_first_stage_is_repeated_and_one_at_work_is_left_alone(videos, done, tmp_path):
    out = tmp_path / "dance"
    with _run_folder.only_run(out, out), pytest.raises(InputError, match="another run is writing to"):
        run(videos, out, height=1.8)
    (out / ".0123456789ab.partial.capture").mkdir(parents=True)
    (out / "lock").write_text("")
    assert again(videos, out)[1] == STAGES
    (out / "run.json").write_text("{")
    with pytest.raises(InputError, match=r"run\.json cannot be read .* or delete \S+dance and every stage"):
        run(videos, out, height=1.8)


@pytest.mark.parametrize("on_a_terminal", [False, True])
def test_the_page_is_named_whole_whatever_its_path(videos, done, tmp_path, capsys, monkeypatch, on_a_terminal):
    if on_a_terminal:
        monkeypatch.setenv("FORCE_COLOR", "1")
        monkeypatch.setenv("COLUMNS", "40")
    out = tmp_path / "dance [final] [" / "b]"
    assert command(["run", *map(str, videos), "--height", "1.8", "--out", str(out)]) in (0, 3)
    assert f"Open {out / 'result' / 'report.html'}\n" in capsys.readouterr().out


def test_whoever_stops_a_run_is_told_that_it_goes_on(videos, done, tmp_path, capsys, monkeypatch):
    def stopped(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(_run_work, "track_capture", stopped)
    assert command(["run", *map(str, videos), "--height", "1.8", "--out", str(tmp_path / "dance")]) == 130
    assert "interrupted; no result was written; the same command goes on where it" in capsys.readouterr().err


def test_the_time_of_a_draft_is_not_that_of_the_paper_nor_that_of_other_frames(videos, done, tmp_path):
    seconds: list[float] = []
    for told in ({"quality": "draft"}, {"quality": "draft", "seed": 1}, {"quality": "paper"}, {"frames": (0, 3)}):
        run(videos, tmp_path / "dance", height=1.8, plan=lambda stages: seconds.append(stages[-1].seconds), **told)
    first, same, *others = seconds
    assert same < 2 < 90 < min(first, *others)


def test_a_camera_is_called_as_in_the_capture_or_like_its_video_now(videos, done, tmp_path):
    out, moved = tmp_path / "dance", [videos[0], Path(shutil.copy(videos[1], tmp_path / "b.mp4"))]
    again(videos, out)
    again(moved, out, person={"b": (3.0, 4.0)})
    assert json.loads((out / "capture" / "keypoints" / "left.json").read_text()) == [["right_hand", [3.0, 4.0]]]
    assert again(moved, out, person={"right_hand": (3.0, 4.0)})[1] == []
    with pytest.raises(InputError, match=r"--focal names 'me'; .*: left, right_hand"):
        again(moved, out, focal={"me": 900.0})


def test_what_is_advised_works_as_it_is_said(videos, done, tmp_path, monkeypatch):
    stand_in, said, capture = _run_footage.calibrate_folder, [], tmp_path / "dance" / "capture"

    def calibrate(folder, say, **options):
        stand_in(folder, say, **options)
        warnings = ["if the result leans, give it with --up", "or calibrate with --key-step 2 if it is", "with --pose"]
        return SimpleNamespace(record={"warnings": warnings})

    monkeypatch.setattr(_run_footage, "calibrate_folder", calibrate)
    again(videos, tmp_path / "dance", say=said.append)
    calibrated = f"jaxmocap calibrate {capture} --replace --height 1.8"
    assert f"Warning: if the result leans, give it with {calibrated} --up X Y Z." in said
    assert f"Warning: or run {calibrated} --key-step 2 if it is." in said
    assert f"Warning: with jaxmocap track {capture} --pose FILE --out DIR." in said
    said.clear()
    again(videos, tmp_path / "dance", camera_distance=2.0, say=said.append)
    assert any("--replace --camera-distance 2 --key-step 2" in sentence for sentence in said)


def test_the_command_prints_plan_and_report(videos, done, tmp_path, capsys):
    out = tmp_path / "dance"
    arguments = ["run", *map(str, videos), "--height", "1.8", "--out", str(out), "--frames", "0:2", "--json"]
    assert command(arguments) in (0, 3)
    told = capsys.readouterr()
    assert json.loads(told.out)["report"] == str(out / "result" / "report.html")
    assert "4. calibrate: find the cameras, to do, about " in told.err
    assert command([*arguments[:-2], "5:2"]) == 2
    assert "frames 5:2 were asked for, but left.mp4 has 12 frames" in capsys.readouterr().err
    assert command([*arguments[:-2], "0:99"]) == 2
    assert "frames 0:99 were asked for, but left.mp4 has 12 frames" in capsys.readouterr().err


def test_portrait_beside_landscape_keeps_its_shape(videos, done, tmp_path):
    again(videos, tmp_path / "dance")
    assert Capture.open(tmp_path / "dance" / "capture").recorded_sizes == ((64, 48), (48, 64))


def test_other_frames_calibrate_again_only_where_a_camera_is_lost_in_them(videos, tmp_path, done):
    """The right camera is lost from frame 6 on."""
    out = tmp_path / "dance"
    run(videos, out, height=1.8, frames=(0, 4))
    assert again(videos, out, frames=(0, 6))[1] == ["selected frames", "track"]
    assert "calibrate" in run(videos, out, height=1.8, frames=(0, 12)).seconds


@pytest.mark.parametrize(("said", "expected"), [({}, "None"), ({"static": True}, "True")])
def test_the_videos_tell_whether_cameras_stand_still_unless_it_is_said(videos, tmp_path, done, said, expected):
    out = tmp_path / "dance"
    run(videos, out, height=1.8, **said)
    assert (out / "capture" / "cameras" / "static").read_text() == expected


def test_frames_the_wrong_way_round_are_refused(videos, tmp_path, done):
    with pytest.raises(InputError, match=r"frames 8:3 were asked for, but left.mp4 has 12 frames, 0 to 11"):
        run(videos, tmp_path / "dance", height=1.8, frames=(8, 3))
    assert not (tmp_path / "dance").exists()
