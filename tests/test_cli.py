"""The command line: exit codes, one sentence per mistake, JSON alone on standard output, and whole runs."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import jaxlib
import numpy as np
import pytest
import trimesh
from rich.table import Table

from jaxmocap._cli import _output, _run, run
from jaxmocap._cli._output import progress, show
from jaxmocap.capture import Capture
from jaxmocap.character import Character
from jaxmocap.metrics import silhouette_iou
from jaxmocap.motion import Motion
from jaxmocap.synthetic import make_capture, write_capture

COMMAND = [sys.executable, "-m", "jaxmocap"]
SIZE = (320, 180)


@pytest.fixture(scope="module")
def films(tmp_path_factory) -> Path:
    """A faultless capture of 4 small frames; copy it before spoiling it."""
    return write_capture(make_capture(4, SIZE), tmp_path_factory.mktemp("films") / "capture")


@pytest.fixture
def film(films, tmp_path) -> Path:
    return Path(shutil.copytree(films, tmp_path / "capture"))


@pytest.fixture
def result(film, tmp_path) -> Path:
    """A result as `track` would write it: the true poses, recorded as tracked in `film`."""
    shown = make_capture(4, SIZE)
    provenance = {"truth": str(film / "truth.npz"), "seconds_per_frame": 1.5}
    motion = Motion.from_poses(
        shown.character, shown.poses, np.arange(4), shown.timestamps, cameras=shown.cameras, provenance=provenance
    )
    return motion.save(tmp_path / "result")


def refused(arguments: list[object], capsys) -> str:
    """The sentence with which a command is refused; only names of stages may stand before it."""
    assert run([str(argument) for argument in arguments]) == 2
    out, err = capsys.readouterr()
    *stages, sentence = err.splitlines()
    assert out == ""
    assert sentence.startswith("jaxmocap: ")
    assert all(stage.endswith(" ...") for stage in stages)
    return sentence


# Starting up ------------------------------------------------------------------------------------------------------


def test_a_path_stays_in_one_piece_where_no_terminal_reads_it(capsys):
    long = "a folder with blanks/" * 12
    show(None, lambda: f"{long}: open it", json_wanted=False)
    assert capsys.readouterr().out == f"{long}: open it\n"
    table = Table("file")
    table.add_row(long)
    show(None, lambda: table, json_wanted=False)
    assert long in capsys.readouterr().out


def test_no_help_offers_none_as_a_choice(capsys):
    for name in _run._COMMANDS:
        with pytest.raises(SystemExit):
            run([name, "--help"])
        assert "{None" not in capsys.readouterr().out, name


@pytest.mark.parametrize("option", [("--workers", "2"), ("--scheduler", "tcp://127.0.0.1:9")])
def test_without_dask_a_sentence_names_the_extra_and_nothing_is_written(option, small, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "distributed", None)  # as if it were not installed
    out = tmp_path / "out"
    for arguments in (["bench", "paper", "--quick"], ["batch", small]):
        assert refused([*arguments, "--out", out, *option], capsys) == (
            "jaxmocap: several workers need Dask, which is not installed; run pip install 'jaxmocap[cluster]', or "
            "leave --workers and --scheduler out."
        )
        assert not out.exists()


def test_whoever_reads_the_output_may_end_first():
    """As in `jaxmocap track --help | head -1`."""
    with subprocess.Popen([*COMMAND, "track", "--help"], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as running:
        running.stdout.close()
        assert running.stderr.read() == b""
        assert running.wait() == 141


@pytest.mark.parametrize("arguments", [["--help"], ["track", "--help"]])
def test_help_answers_at_once_and_without_jax(arguments):
    begin = time.perf_counter()
    done = subprocess.run([*COMMAND, *arguments], capture_output=True, text=True, check=True)
    assert time.perf_counter() - begin < 2
    assert "usage: jaxmocap" in done.stdout
    modules = "import sys; from jaxmocap._cli import run; assert 'jax' not in sys.modules"
    subprocess.run([sys.executable, "-c", modules], check=True)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "Missing subcommand"),
        (["fly"], "fly"),
        (["track", "somewhere"], "--out"),
        (["track", "somewhere", "--out", "x", "--quality", "best"], "'draft', 'normal', 'paper'"),
        (["track", "somewhere", "--out", "x", "--seed", "pi"], "--seed"),
    ],
)
def test_usage_errors_exit_with_2_and_say_what_was_expected(arguments, words, capsys):
    with pytest.raises(SystemExit) as exit_:
        run(arguments)
    assert exit_.value.code == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert words in " ".join(err.replace("│", " ").split())


@pytest.mark.parametrize(
    ("option", "arguments"),
    [
        ("--methods", ["bench", "paper", "--out", "x", "--methods", "ours", "--methods", "flow"]),
        ("--offset", ["run", "a.mp4", "b.mp4", "--offset", "a=1", "--offset=b=2"]),
    ],
)
def test_an_option_given_twice_is_refused_and_not_half_forgotten(option, arguments, capsys):
    assert run(arguments) == 2
    (sentence,) = capsys.readouterr().err.splitlines()
    assert sentence.startswith(f"jaxmocap: {option} is given more than once")


def test_prepare_keeps_what_the_user_has_set(monkeypatch):
    code = (
        "import jaxmocap; jaxmocap.configure(); import jax;"
        "print(jax.config.jax_compilation_cache_dir, jax.config.jax_persistent_cache_min_compile_time_secs,"
        "jax.device_count())"
    )
    unset = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    ours = subprocess.run(
        [sys.executable, "-c", code], env=unset | {"XDG_CACHE_HOME": "/c"}, capture_output=True, text=True, check=True
    )
    theirs = unset | {"JAX_COMPILATION_CACHE_DIR": "/elsewhere", "JAX_NUM_CPU_DEVICES": "3", "JAX_PLATFORMS": "cpu"}
    theirs |= {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.25"}
    kept = subprocess.run([sys.executable, "-c", code], env=theirs, capture_output=True, text=True, check=True)
    if sys.platform == "linux":
        assert ours.stdout.startswith("/c/jaxmocap/xla 0.0 ")
    assert kept.stdout.split() == ["/elsewhere", "0.25", "3"]


def test_prepare_adds_its_flag_for_the_compiler_to_the_user_s():
    flag = "--xla_cpu_use_fusion_emitters=false"
    code = "import jaxmocap, os; jaxmocap.configure(); jaxmocap.configure(); print(os.environ.get('XLA_FLAGS'))"
    said = {}
    for given in ("", "--xla_cpu_use_fusion_emitters=true", "--xla_backend_optimization_level=2"):
        environment = os.environ | {"XLA_FLAGS": given}
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        said[given] = done.stdout.strip()
    if jaxlib.__version__.startswith("0.10."):
        assert list(said.values()) == [
            flag,
            "--xla_cpu_use_fusion_emitters=true",
            f"--xla_backend_optimization_level=2 {flag}",
        ]
    else:
        assert all(flag not in words for words in said.values())


# Mistakes ---------------------------------------------------------------------------------------------------------


def test_a_mistake_in_a_process_of_its_own_is_one_line_and_no_traceback(tmp_path):
    arguments = [*COMMAND, "track", str(tmp_path / "nowhere"), "--out", str(tmp_path / "out")]
    done = subprocess.run(arguments, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1
    assert "nowhere" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["track", "register"])
def test_missing_captures_broken_settings_and_missing_actors_are_sentences(command, film, tmp_path, capsys):
    out = ["--out", tmp_path / "out"]
    assert "nowhere/capture.toml" in refused([command, tmp_path / "nowhere" / "capture.toml", *out], capsys)
    toml = film / "capture.toml"
    whole = toml.read_text()
    toml.write_text("name = \n" + whole)
    assert "line 1 is not valid TOML" in refused([command, film, *out], capsys)
    toml.write_text(whole.replace('actor = "actor.glb"\n', ""))
    assert "names no actor" in refused([command, film, *out], capsys)
    toml.write_text(whole.replace('cameras = "cameras"\n', ""))
    assert "cameras" in refused([command, film, *out], capsys)
    assert not (tmp_path / "out").exists()


def test_results_of_others_are_never_overwritten(film, result, tmp_path, capsys):
    before = {path.name: path.read_bytes() for path in result.iterdir()}
    assert "result of another run" in refused(["track", film, "--out", result], capsys)
    assert "exists already" in refused(["register", film, "--out", result], capsys)
    assert "exists already" in refused(["demo", "--out", result], capsys)
    assert {path.name: path.read_bytes() for path in result.iterdir()} == before
    (tmp_path / "file").touch()
    assert "is a file" in refused(["track", film, "--out", tmp_path / "file"], capsys)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("search.gating", "NAME=VALUE was expected"),
        ("search.clam=off", "there is no 'clam'"),
        ("refine.rounds=few", "a whole number from 0 was expected"),
    ],
)
def test_settings_that_are_not_there_are_refused(setting, words, film, tmp_path, capsys):
    assert words in refused(["track", film, "--out", tmp_path / "out", "--set", "search.retry=off", setting], capsys)
    assert not (tmp_path / "out").exists()


def test_detections_that_cannot_be_used_are_refused(film, tmp_path, capsys):
    start = ["track", film, "--out", tmp_path / "out"]
    assert "there is no such folder" in refused([*start, "--detections", tmp_path / "nowhere"], capsys)
    (tmp_path / "empty").mkdir()
    assert "hold no file of capture" in refused([*start, "--detections", tmp_path / "empty"], capsys)
    assert "--detections-frames" in refused([*start, "--detections-frames", "3"], capsys)
    assert "name their folder with --detections" in refused([*start, "--detections-frames", "0:2"], capsys)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("frames", "words"),
    [("10", "A:B"), ("a:b", "A:B"), ("-3:2", "A:B"), ("2:2", "0 <= A < B <= 4"), ("0:9", "the capture has 4 frames")],
)
def test_frames_that_are_not_there_are_refused(frames, words, film, tmp_path, capsys):
    assert words in refused(["track", film, "--out", tmp_path / "out", f"--frames={frames}"], capsys)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", "JSON"),
        ("[]", "frames"),
        ('{"0": {"l_elbow_flexion": 30}}', "l_elbow_flexion"),
        ('{"0": {"l_elbow_flex": 300}}', "limits"),
        ('{"0": {"l_elbow_flex": "bent"}}', "number"),
        ('{"1": {"l_elbow_flex": 30}}', "frame 1, which is not registered"),
    ],
)
def test_pose_files_that_cannot_be_used_are_refused(content, words, film, tmp_path, capsys):
    (tmp_path / "pose.json").write_text(content)
    for verb in ("track", "register", "segment") if "not registered" in words else ("track",):
        sentence = refused([verb, film, "--out", tmp_path / "out", "--pose", tmp_path / "pose.json"], capsys)
        assert words in sentence
    assert not (tmp_path / "out").exists()


def test_a_place_where_nothing_can_be_is_a_sentence(tmp_path, capsys):
    (tmp_path / "file").write_text("mine")
    assert "cannot be read or written" in refused(["body", "--out", tmp_path / "file" / "body.glb"], capsys)
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize("command", ["track", "register", "fit-character"])
def test_an_actor_that_is_not_there_is_refused(command, film, tmp_path, capsys):
    out = tmp_path / "out.glb"
    assert "nobody.glb" in refused([command, film, "--out", out, "--actor", tmp_path / "nobody.glb"], capsys)
    assert not out.exists()


def test_characters_are_not_fitted_to_too_few_frames_nor_written_over_others(film, tmp_path, capsys):
    out = tmp_path / "fitted.glb"
    assert "needs 3 such frames" in refused(["fit-character", film, "--out", out], capsys)
    assert "no frame 7" in refused(["fit-character", film, "--out", out, "--at", 0, 2, 7], capsys)
    assert not out.exists()
    assert "ends in .glb" in refused(["fit-character", film, "--out", tmp_path / "fitted.obj"], capsys)
    out.write_bytes(b"of another")
    assert "exists already" in refused(["fit-character", film, "--out", out], capsys)
    assert out.read_bytes() == b"of another"


def test_a_demo_of_one_frame_is_refused(tmp_path, capsys):
    assert "at least 2" in refused(["demo", "--out", tmp_path / "demo", "--frames", "1"], capsys)


def test_answers_in_json_hold_null_where_a_number_is_not_known(capsys):
    show({"out": Path("a/b"), "mean": float("nan"), "max": [1.5, float("inf")]}, str, json_wanted=True)
    assert json.loads(capsys.readouterr().out) == {"out": "a/b", "mean": None, "max": [1.5, None]}


# check ------------------------------------------------------------------------------------------------------------


def test_check_of_a_faultless_capture_exits_with_0_and_describes_the_actor(film, capsys):
    assert run(["check", str(film), "--json"]) == 0
    out, err = capsys.readouterr()
    findings = json.loads(out)
    assert err == ""
    assert {finding["severity"] for finding in findings} <= {"warning", "note"}
    assert any(finding["where"] == "actor" and "triangles" in finding["message"] for finding in findings)


@pytest.mark.slow
def test_check_of_a_capture_with_a_bare_actor_rigs_it_and_says_so(film, capsys):
    character = Character.load(film / "actor.glb")
    mesh = trimesh.Trimesh(np.asarray(character.vertices), np.asarray(character.faces), process=False)
    mesh.export(film / "bare.obj")
    (film / "capture.toml").write_text((film / "capture.toml").read_text().replace("actor.glb", "bare.obj"))
    assert run(["check", str(film), "--json"]) == 0
    said = [finding["message"] for finding in json.loads(capsys.readouterr().out) if finding["where"] == "actor"]
    assert any("bare.obj has no skeleton and was rigged" in message for message in said)


def test_check_lists_every_error_and_exits_with_2(film, capsys):
    (film / "actor.glb").write_bytes(b"glTF but not really")
    assert run(["check", str(film)]) == 2
    assert "actor.glb" in capsys.readouterr().out.replace("\n", "")
    (film / "cam1.mp4").unlink()
    (film / "capture.toml").write_text((film / "capture.toml").read_text().replace('"masks"', '"maks"'))
    assert run(["check", str(film), "--json"]) == 2
    findings = json.loads(capsys.readouterr().out)
    errors = [finding["message"] for finding in findings if finding["severity"] == "error"]
    assert any("cam1.mp4" in error for error in errors)
    assert any("maks" in error for error in errors)
    assert findings[-1] == {
        "severity": "note",
        "where": "actor",
        "message": "was not examined; it is once the errors above are mended",
    }


def test_check_of_nothing_is_an_error(tmp_path, capsys):
    assert run(["check", str(tmp_path), "--json"]) == 2
    assert "capture.toml" in json.loads(capsys.readouterr().out)[0]["message"]


# evaluate ---------------------------------------------------------------------------------------------------------


def test_evaluate_finds_the_truth_of_the_tracked_capture(result, capsys):
    assert run(["evaluate", str(result), "--json"]) == 0
    out, err = capsys.readouterr()
    scores = json.loads(out)
    assert err == ""
    assert scores["frames"] == 4
    assert scores["seconds_per_frame"] == 1.5
    assert scores["marker_error_cm"]["mean"] < 0.01
    assert scores["joint_error_cm"]["max"] < 0.01
    assert run(["evaluate", str(result)]) == 0
    assert "Markers" in capsys.readouterr().out
    assert {"pelvis", "spine", "head"} < set(scores["joints_scored"])  # a synthetic truth has our own joints
    assert run(["evaluate", str(result), "--joints", "l_knee", "nose", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["joints_scored"] == ["l_knee", "nose"]
    assert "has no joint 'tail'" in refused(["evaluate", result, "--joints", "tail"], capsys)


def test_evaluate_without_a_truth_or_a_result_is_refused(film, result, tmp_path, capsys):
    assert "nowhere.npz" in refused(["evaluate", result, "--truth", tmp_path / "nowhere.npz"], capsys)
    assert "is not a result" in refused(["evaluate", film], capsys)
    (film / "truth.npz").unlink()
    assert "--truth" in refused(["evaluate", result], capsys)
    motion = Motion.load(result)
    untold = Motion.from_poses(motion.character, motion.poses, motion.frames, motion.timestamps)
    untold.save(tmp_path / "untold")
    assert "without a truth" in refused(["evaluate", tmp_path / "untold"], capsys)


# report-page ------------------------------------------------------------------------------------------------------


def test_report_page_writes_the_page_of_a_result_again(film, result, capsys):
    assert run(["report-page", str(result), "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out) == {"page": str(result / "report.html")}
    assert "no pictures: there is no overlay_cam0.mp4" in err
    assert "<!doctype html>" in (result / "report.html").read_text()
    assert "is not a result" in refused(["report-page", film], capsys)


# track, register, demo --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_an_interrupted_run_leaves_nothing_behind(film, tmp_path):
    running = subprocess.Popen(
        [*COMMAND, "track", str(film), "--out", str(tmp_path / "out"), "--no-cache"], stderr=subprocess.PIPE, text=True
    )
    assert running.stderr is not None
    assert "register" in running.stderr.readline()
    running.send_signal(signal.SIGINT)
    _, err = running.communicate(timeout=120)
    assert running.returncode == 130
    assert err.strip().splitlines()[-1].startswith("jaxmocap: interrupted")
    assert "Traceback" not in err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_register_writes_poses_and_pictures(film, tmp_path, capsys):
    (tmp_path / "pose.json").write_text('{"2": {"l_elbow_flex": 20}}')
    shutil.move(film / "actor.glb", tmp_path / "elsewhere.glb")
    toml = film / "capture.toml"
    toml.write_text(toml.read_text().replace('actor = "actor.glb"\n', ""))
    arguments = ["register", film, "--out", tmp_path / "out", "--pose", tmp_path / "pose.json", "--json"]
    arguments += ["--actor", tmp_path / "elsewhere.glb"]
    assert run([str(argument) for argument in arguments]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record == json.loads((tmp_path / "out" / "registration.json").read_text())
    assert record["2"]["pose"]["l_elbow_flex"] == pytest.approx(20, abs=0.01)
    assert min(record["0"]["iou"]) > 0.85
    assert record["0"]["masks"] == {"cam0": {"source": "given"}, "cam1": {"source": "given"}}
    names = {path.name for path in (tmp_path / "out").glob("*.png")}
    assert names == {f"overlay_cam{camera}_0000{frame}.png" for camera in (0, 1) for frame in (0, 2)}


@pytest.mark.slow
def test_segment_writes_masks_that_a_capture_can_use_and_chooses_frames(film, tmp_path, capsys):
    text = (film / "capture.toml").read_text()
    lines = [line for line in text.splitlines() if not line.startswith(("masks", "selected_frames"))]
    (film / "capture.toml").write_text("\n".join(lines) + "\n")
    assert run(["segment", str(film), "--out", str(tmp_path / "out"), "--json"]) == 0
    out, err = capsys.readouterr()
    record = json.loads(out)
    assert record == json.loads((tmp_path / "out" / "segmentation.json").read_text())
    assert "names no selected_frames; 0, 2 are used" in err
    names = {f"cam{camera}_0000{frame}.png" for camera in (0, 1) for frame in (0, 2)}
    assert {path.name for path in (tmp_path / "out" / "masks").iterdir()} == names
    assert {path.name for path in (tmp_path / "out").glob("*.png")} == {f"overlay_{name}" for name in names}
    shutil.rmtree(film / "masks")
    shutil.move(tmp_path / "out" / "masks", film / "masks")
    (film / "capture.toml").write_text('masks = "masks"\n' + (film / "capture.toml").read_text())
    used, truth = Capture.open(film), make_capture(4, SIZE).masks
    for frame in (0, 2):
        for camera in (0, 1):
            assert record[str(frame)][f"cam{camera}"]["source"] == "found"
            assert silhouette_iou(used.mask(camera, frame), truth[frame, camera]) > 0.85
    assert run(["segment", str(film), "--out", str(tmp_path / "again"), "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["0"]["cam0"] == {"source": "given"}


@pytest.mark.slow
def test_track_from_the_command_line_is_as_good_as_it_says_and_repeatable(film, tmp_path, capsys):
    arguments = ["track", film, "--quality", "draft", "--frames", "1:4", "--json", "--out"]
    motions = []
    for name in ("one", "two"):
        assert run([str(argument) for argument in (*arguments, tmp_path / name)]) == 0
        told = json.loads(capsys.readouterr().out)
        assert (told["frames"], told["lost_frames"]) == (3, 0)
        motions.append(Motion.load(tmp_path / name))
    assert {path.name for path in (tmp_path / "one").iterdir()} == {
        "motion.npz", "report.json", "registration.json", "overlay_cam0.mp4", "overlay_cam1.mp4", "report.html",
    }  # fmt: skip
    assert motions[0].frames.tolist() == [1, 2, 3]
    np.testing.assert_array_equal(motions[0].root, motions[1].root)
    np.testing.assert_array_equal(motions[0].angles, motions[1].angles)
    assert run(["evaluate", str(tmp_path / "one"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["marker_error_cm"]["mean"] < 5


@pytest.mark.slow
def test_the_demo_of_a_few_frames_runs_from_nothing(tmp_path):
    arguments = [*COMMAND, "demo", "--out", str(tmp_path / "demo"), "--frames", "4", "--json"]
    done = subprocess.run(arguments, capture_output=True, text=True)
    assert done.returncode in (0, 3), done.stderr
    scores = json.loads(done.stdout)
    assert scores["frames"] == 4
    assert scores["marker_error_cm"]["mean"] < 5
    assert {path.name for path in (tmp_path / "demo").iterdir()} == {"capture", "result", "contact_sheet.png"}


def test_away_from_a_terminal_long_stages_say_every_tenth(capsys):
    with progress() as report:
        for stage, total in (("register", 2), ("track", 40)):
            for done in range(total + 1):
                report(stage, done, total)
    said = capsys.readouterr().err.splitlines()
    assert said == ["register ...", "track ...", *(f"track {done} of 40" for done in range(4, 41, 4))]


def test_away_from_a_terminal_steps_that_take_long_are_said(capsys, monkeypatch):
    """As the first frames do, which compile; six frames are too few for every tenth."""
    clock = [0.0]
    monkeypatch.setattr(_output, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    with progress() as report:
        for done, seconds in enumerate([0, 50, 50, 3, 3, 3, 3]):
            clock[0] += seconds
            report("track", done, 6)
    assert capsys.readouterr().err.splitlines() == ["track ...", "track 1 of 6", "track 2 of 6"]
