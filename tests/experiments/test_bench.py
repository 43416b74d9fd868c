"""`bench` from the list of trials to files and exit codes, with runs that take no time; and one real one."""

import csv
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from jaxmocap._cli import run as command
from jaxmocap._results import InputError
from jaxmocap.appearance import appearance_preset
from jaxmocap.baselines import METHODS
from jaxmocap.experiments import STORIES, CaptureSpec, Inputs, Run, _bench, _sweep, bench, film, paper, perform, without
from jaxmocap.synthetic import make_capture, write_capture
from jaxmocap.track import Tracker, with_settings


class Nothing:
    """Stands for a motion."""

    def save(self, folder, overwrite=False):
        folder.mkdir(parents=True, exist_ok=True)


@pytest.fixture
def quick_runs(monkeypatch):
    """Every method is as good as its place in the list."""
    offset = {"cm": 0.0}

    def perform(run, captures):
        error = 1.0 + list(METHODS).index(run.method) + offset["cm"]
        record = run.described() | {"key": run.key, "status": "done", "capture": run.capture_name}
        record |= {"marker_error_cm": error, "marker_error_max_cm": error, "error_per_frame_cm": [error, error]}
        record |= {"frame_numbers": [0, 1], "seconds_per_frame": 1.0, "seconds": 1.0, "cpu_seconds": 1.0}
        return record | {"capture_hash": "0", "device": "none", "versions": {"jaxmocap": "0"}}, Nothing()

    monkeypatch.setattr(_sweep, "perform", perform)
    monkeypatch.setattr(_bench, "_folders", lambda trials, out: {})
    return offset


def test_the_quick_paper_compares_every_method_on_every_story_and_leaves_parts_out():
    trials = paper(quick=True)
    compared = {(t.run.method, t.run.capture_name) for t in trials if t.experiment == "comparison"}
    assert compared == {(method, capture) for method in METHODS for capture in STORIES}
    assert {t.experiment for t in trials} >= {"Fig. 11 background", "Fig. 12 search", "Fig. 13 view-view", "Fig. 14 L1"}
    assert len({t.run.key for t in trials}) < len(trials)  # all parts of an ablation is ours of the comparison
    assert {t.run.quality for t in trials} == {"draft"}
    assert {t.run.quality for t in paper(quick=True, quality="normal")} == {"normal"}


def test_the_whole_paper_varies_what_ours_adds():
    factors = {t.factor for t in paper()}
    assert factors >= {
        "lambda", "particles", "iterations", "degrees", "cameras", "pixels", "change", "millimetres", "shading",
        "every n-th pixel", "background grid", "selected frames",
    }  # fmt: skip
    assert {t.run.seed for t in paper()} == {0, 1, 2}


def test_silhouettes_are_seen_from_few_and_from_far_apart_views():
    trials = [t for t in paper(seeds=(0,)) if t.experiment == "Fig. 15 views"]
    filmed = {(a["num_cameras"], a["view_angle_degrees"]) for a in (t.run.capture.arguments for t in trials)}
    assert filmed == {(2, 27.0), (2, 80.0), (3, 60.0)}
    assert len({t.run.capture_name for t in trials}) == 3
    assert {t.value for t in trials} == {"ours", "hasler-5", "posecut", "hasler-1"}


@pytest.mark.parametrize(("quick", "quality"), [(True, "draft"), (True, "normal"), (False, "normal")])
def test_all_settings_of_the_paper_can_be_made(quick, quality):
    """Names of settings that do not exist would only be found hours later."""
    for trial in paper(quick, quality=quality):
        with_settings(Tracker.preset(quality), trial.run.settings)
        with_settings(appearance_preset(quality), trial.run.appearance)


def test_without_the_l1_the_prediction_keeps_its_weight():
    _, settings, _ = without("no L1", "normal")
    before, after = Tracker.preset("normal").refine, with_settings(Tracker.preset("normal"), settings).refine
    assert float(after.weights.regularisation) < 1e-3 * float(before.weights.regularisation)
    assert float(after.weights.regularisation * after.weights.prior) == pytest.approx(
        float(before.weights.regularisation * before.weights.prior), rel=1e-4
    )


def test_one_call_writes_the_table_the_figures_and_the_report(quick_runs, tmp_path):
    result = bench("paper", tmp_path / "out", quick=True, only="comparison|Fig. 12")
    assert result.failed == []
    with (tmp_path / "out" / "runs.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(METHODS) * len(STORIES) + 2
    assert {row["capture_hash"] for row in rows} == {"0"}
    text = (tmp_path / "out" / "report.md").read_text()
    behind = f"+{list(METHODS).index('posecut')}.00"
    assert f"| posecut | 6 | {behind} | [{behind}, {behind}] | ours is better |" in text
    assert (tmp_path / "out" / "report.html").read_text().count("<svg") == len(STORIES)


def test_the_gate_exits_with_one_on_a_planted_regression(quick_runs, tmp_path, capsys):
    arguments = ["bench", "paper", "--quick", "--only", "comparison", "--out"]
    assert command([*arguments, str(tmp_path / "before")]) == 0
    baseline = str(tmp_path / "before" / "figures.json")
    assert command([*arguments, str(tmp_path / "same"), "--gate", baseline]) == 0
    quick_runs["cm"] = 1.0
    assert command([*arguments, str(tmp_path / "worse"), "--gate", baseline]) == 1
    complaint = "comparison, mean of 6 captures, ours: marker error: 2.0 cm, was 1.0"
    assert complaint in capsys.readouterr().err.replace("\n", " ")
    other = tmp_path / "other"
    assert command([*arguments, str(other), "--quality", "normal", "--gate", baseline]) == 2
    assert not other.exists()  # said before anything is run
    assert "has quality draft, this run normal" in capsys.readouterr().err.replace("\n", " ")


def test_failures_are_listed_and_the_answer_is_json(quick_runs, tmp_path, capsys, monkeypatch):
    plain = _sweep.perform

    def perform(run, captures):
        if run.method == "posecut":
            raise InputError("no cut.")
        return plain(run, captures)

    monkeypatch.setattr(_sweep, "perform", perform)
    out = str(tmp_path / "out")
    assert command(["bench", "paper", "--quick", "--only", "comparison", "--out", out, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["failed_runs"] == len(STORIES)
    assert set(answer["failures"].values()) == {"no cut."}


def test_mistakes_are_sentences(tmp_path, capsys):
    with pytest.raises(InputError, match="no method 'ourselves'"):
        bench("paper", tmp_path, methods=["ourselves"])
    with pytest.raises(InputError, match="no experiment matches"):
        bench("paper", tmp_path, quick=True, only="Fig. 99")
    with pytest.raises(InputError, match="no regular expression"):
        bench("paper", tmp_path, quick=True, only="(")
    with pytest.raises(InputError, match="give captures too"):
        bench("paper", tmp_path, frames=(0, 2))
    assert command(["bench", "paper", "--out", str(tmp_path / "x"), "--frames", "0:3"]) == 2
    assert "--capture" in capsys.readouterr().err


def test_a_capture_of_one_s_own_needs_a_truth(tmp_path):
    folder = write_capture(make_capture(2, (96, 54)), tmp_path / "capture")
    toml = folder / "capture.toml"
    toml.write_text("".join(line for line in toml.read_text().splitlines(True) if not line.startswith("truth")))
    with pytest.raises(InputError, match="no truth"):
        bench("paper", tmp_path / "out", captures=[folder])


@pytest.mark.parametrize(
    ("given", "seeds", "quality"),
    [
        ({}, {0, 1, 2}, "normal"),
        ({"quick": True}, {0}, "draft"),
        ({"quick": True, "seeds": (4, 5), "quality": "normal"}, {4, 5}, "normal"),
    ],
)
def test_seeds_and_preset_on_captures_of_one_s_own_are_those_of_the_suite(quick_runs, tmp_path, given, seeds, quality):
    folder = write_capture(make_capture(2, (96, 54)), tmp_path / "capture")
    rows = bench("paper", tmp_path / "out", captures=[folder], methods=["ours"], **given).rows
    assert [(row["seed"], row["quality"]) for row in rows] == [(seed, quality) for seed in sorted(seeds)]


def test_two_captures_of_the_same_name_are_refused(tmp_path):
    for place in ("monday/Walk", "tuesday/walk"):
        (tmp_path / place).mkdir(parents=True)
        (tmp_path / place / "capture.toml").touch()
    folders = [tmp_path / "monday" / "Walk", tmp_path / "tuesday" / "walk" / "capture.toml"]
    with pytest.raises(InputError, match=r"two captures are called 'walk' \(\S+monday/Walk and \S+tuesday/walk\)"):
        bench("paper", tmp_path / "out", captures=folders)


@pytest.mark.slow
def test_a_real_run_with_noisy_inputs_from_the_true_pose(tmp_path):
    """Five frames by keypoints, which takes least: it is the inputs that are tested."""
    spec = CaptureSpec("square", {"num_frames": 5, "size": (160, 90), "selected_frames": [0], "sensor_noise": 0.0})
    coarse = {"grid.rows": 8, "grid.columns": 8}
    base = Run(spec, "keypoints", "draft", appearance=coarse, inputs=Inputs(start="truth"))
    record, motion = perform(base, tmp_path)
    assert record["status"] == "done"
    assert max(record["error_per_frame_cm"]) < 4.0
    assert record["error_per_frame_cm"][0] < 0.01
    assert len(motion) == record["frames_tracked"] == 5
    assert record["marker_error_by_frame_cm"] == record["marker_error_cm"]  # as published, nothing is solved as a clip
    assert record["joint_error_solved_cm"] < 0.9 * record["joint_error_by_frame_cm"]
    assert record["cpu_seconds"] > 0
    noisy = Inputs(start="truth", camera_degrees=1.0, camera_centimetres=2.0, mesh_millimetres=10.0)
    worse, moved = perform(replace(base, inputs=noisy), tmp_path)
    assert worse["marker_error_cm"] > record["marker_error_cm"]
    gap = np.linalg.norm(np.asarray(moved.character.vertices) - np.asarray(motion.character.vertices), axis=1)
    assert 0.006 < np.sqrt((gap**2).mean()) < 0.012
    folder = film(spec, tmp_path)
    shutil.move(folder / "keypoints", folder / "selected")
    shutil.move(folder / "keypoints_all", folder / "keypoints")  # as `detect` leaves them
    again, _ = perform(base, tmp_path)
    assert again["error_per_frame_cm"] == record["error_per_frame_cm"]
    shutil.rmtree(folder / "keypoints")
    shutil.move(folder / "selected", folder / "keypoints")
    with pytest.raises(InputError, match="keypoints at every frame, which 'ours-with-keypoints' needs; find them with"):
        perform(replace(base, method="ours-with-keypoints"), tmp_path)
