"""Sweeps with runs that take no time: what is done, what is not done again, and what becomes of failures."""

import importlib
import json
import os
import signal
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from jaxmocap._results import InputError
from jaxmocap.baselines import METHODS
from jaxmocap.experiments import CaptureSpec, Run, Trial, _sweep, read_record, rows_of, sweep, write_frames, write_table


class Nothing:
    """Stands for a motion."""

    def save(self, folder, overwrite=False):
        folder.mkdir(parents=True, exist_ok=True)


@pytest.fixture
def performed(monkeypatch):
    """The runs that were done; those of seed 13 fail, those of seed 7 are the user's mistake."""
    done = []

    def perform(run, captures):
        done.append(run)
        if run.seed == 13:
            raise RuntimeError("out of luck")
        if run.seed == 7:
            raise InputError("choose another seed.")
        error = 1.0 + 0.1 * run.seed
        record = {"key": run.key, "status": "done", "capture": run.capture_name, **run.described()}
        record |= {"capture": run.capture_name, "marker_error_cm": error, "error_per_frame_cm": [error, error + 1]}
        return record | {"frame_numbers": [0, 1], "versions": {"jaxmocap": "0"}}, Nothing()

    monkeypatch.setattr(_sweep, "perform", perform)
    return done


def runs(*seeds, **changes):
    return [Run(CaptureSpec("square", {"num_frames": 3}), seed=seed, **changes) for seed in seeds]


def test_equal_runs_are_done_once_and_finished_ones_never_again(performed, tmp_path):
    first = sweep([*runs(0, 1), *runs(1)], tmp_path)
    assert len(performed) == len(first) == 2
    again = sweep(runs(0, 1, 2), tmp_path)
    assert [run.seed for run in performed] == [0, 1, 2]
    assert [record["marker_error_cm"] for record in again] == pytest.approx([1.0, 1.1, 1.2])


def test_runs_of_two_versions_are_not_mixed(performed, tmp_path, monkeypatch):
    sweep(runs(0), tmp_path)
    monkeypatch.setattr(_sweep, "code_hash", lambda: "newer")
    with pytest.raises(InputError, match="holds runs of another version of jaxmocap; choose another folder"):
        sweep(runs(0, 1), tmp_path)
    assert len(performed) == 1


def test_any_setting_makes_another_run():
    base = runs(0)[0]
    others = [
        *runs(1), *runs(0, method="local"), *runs(0, quality="draft"), *runs(0, settings={"search": "off"}),
        *runs(0, appearance={"behind": "none"}), *runs(0, frames=(0, 2)),
        Run(CaptureSpec("square", {"num_frames": 4})), Run("square"),
    ]  # fmt: skip
    assert len({run.key for run in [base, *others]}) == len(others) + 1
    assert base.key == runs(0)[0].key


def test_a_failure_is_recorded_and_stops_nothing(performed, tmp_path):
    records = sweep(runs(0, 13, 7, 2), tmp_path)
    assert [record["status"] for record in records] == ["done", "failed", "failed", "done"]
    assert records[1]["error"] == "RuntimeError: out of luck"
    assert "perform" in records[1]["traceback"]
    assert records[2]["error"] == "choose another seed."
    assert records[2]["traceback"] is None
    sweep(runs(0, 13, 7, 2), tmp_path)
    assert len(performed) == 4
    sweep(runs(0, 13, 7, 2), tmp_path, retry_failed=True)
    assert {run.seed for run in performed[4:]} == {13, 7}


@pytest.mark.parametrize(
    ("words", "wrong"),
    [
        ("setting 'search.spred': there is no 'spred'", {"settings": {"search.spred": 1.0}}),
        ("setting 'plate.width': there is no 'width'", {"appearance": {"plate.width": 3}}),
        ("there is no method 'mine'", {"method": "mine"}),
        ("quality 'best' is unknown", {"quality": "best"}),
        ("method 'posecut' has no settings of the tracker", {"method": "posecut", "settings": {"search.spread": 1.0}}),
    ],
)
def test_a_run_that_cannot_work_is_refused_before_the_first_is_done(performed, tmp_path, words, wrong):
    with pytest.raises(InputError, match=words):
        sweep([*runs(0), *runs(1, **wrong)], tmp_path / "out")
    with pytest.raises(InputError, match="nowhere"):
        sweep([*runs(0), Run(str(tmp_path / "nowhere"))], tmp_path / "out")
    assert performed == []
    assert not (tmp_path / "out").exists()


def test_a_folder_may_be_named_by_a_text(performed, tmp_path):
    assert len(sweep(runs(0), str(tmp_path / "out"))) == 1
    assert (tmp_path / "out" / "runs" / f"{runs(0)[0].key}.json").is_file()


def test_a_method_of_one_s_own_is_told_from_an_earlier_form_of_it(performed, tmp_path, monkeypatch):
    """Its numbers and its code make another run; the same ones do not."""
    module = tmp_path / "mine.py"
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def add(step, comment=""):
        module.write_text(
            f"from dataclasses import dataclass\n@dataclass(frozen=True)\nclass Mine:\n    step: float = 0.1{comment}\n"
        )
        monkeypatch.delitem(sys.modules, "mine", raising=False)
        kind = importlib.import_module("mine").Mine
        monkeypatch.setitem(METHODS, "mine", lambda quality: kind(step))
        return runs(0, method="mine")[0]

    keys = [add(0.1).key, add(0.2).key, add(0.1, "  # other code").key]
    assert len(set(keys)) == 3
    again = add(0.1)
    assert again.key == keys[0]
    sweep([again], tmp_path / "out")
    assert sweep([again, *runs(0)], tmp_path / "out")[0]["own_method"] == again.described()["own_method"]
    assert len(performed) == 2
    assert "own_method" not in runs(0)[0].described()


def test_other_processes_learn_of_methods_that_were_added(tmp_path, monkeypatch):
    """A process of a Dask cluster knows jaxmocap's own methods only."""
    known = {}
    monkeypatch.setattr(_sweep, "perform", lambda run, captures: known.update(METHODS) or ({"key": run.key}, Nothing()))
    make = monkeypatch.setitem(METHODS, "mine", lambda quality: quality) or METHODS["mine"]
    sent = []
    monkeypatch.setattr(
        _sweep, "on_workers", lambda call, items, *rest: sent.extend((call, item) for item in items) or ()
    )
    sweep(runs(0, method="mine"), tmp_path)
    monkeypatch.delitem(METHODS, "mine")
    ((call, run),) = sent
    call(run)
    assert known["mine"] is make


def test_an_interruption_passes_and_loses_nothing(performed, tmp_path, monkeypatch):
    plain = _sweep.perform

    def interrupted(run, captures):
        if run.seed == 2:
            raise KeyboardInterrupt
        return plain(run, captures)

    monkeypatch.setattr(_sweep, "perform", interrupted)
    with pytest.raises(KeyboardInterrupt):
        sweep(runs(0, 1, 2, 3), tmp_path)
    assert read_record(tmp_path, runs(1)[0].key) is not None
    assert read_record(tmp_path, runs(2)[0].key) is None
    monkeypatch.setattr(_sweep, "perform", plain)
    assert len(sweep(runs(0, 1, 2, 3), tmp_path)) == 4
    assert [run.seed for run in performed] == [0, 1, 2, 3]


def test_a_killed_process_leaves_whole_records_only(tmp_path):
    """SIGKILL in the middle of the third run."""
    program = textwrap.dedent(f"""
        import os, signal, sys
        sys.path.insert(0, {os.path.dirname(__file__)!r})
        from test_sweep import Nothing, runs
        from pathlib import Path
        from jaxmocap.experiments import _sweep
        def perform(run, captures):
            if run.seed == 2:
                os.kill(os.getpid(), signal.SIGKILL)
            return {{"key": run.key, "status": "done"}}, Nothing()
        _sweep.perform = perform
        _sweep.sweep(runs(0, 1, 2, 3), Path({str(tmp_path)!r}))
    """)
    code = subprocess.run([sys.executable, "-c", program], check=False).returncode
    assert code == -signal.SIGKILL
    found = sorted((tmp_path / "runs").glob("*.json"))
    assert {path.stem for path in found} == {run.key for run in runs(0, 1)}
    assert all(json.loads(path.read_text())["status"] == "done" for path in found)


def test_the_table_has_a_row_per_trial(performed, tmp_path):
    one, two = runs(0, 1)
    trials = [Trial("a", "seed", "0", one), Trial("a", "seed", "1", two), Trial("b", "seed", "0", one)]
    rows = rows_of(trials, sweep([trial.run for trial in trials], tmp_path))
    lines = write_table(rows, tmp_path / "t.csv").read_text().splitlines()
    assert [line.split(",")[:3] for line in lines[1:]] == [["a", "seed", "0"], ["a", "seed", "1"], ["b", "seed", "0"]]
    assert len(performed) == 2
    frames = np.genfromtxt(write_frames(rows, tmp_path / "f.csv"), delimiter=",", names=True, dtype=None, encoding=None)
    assert frames["frame"].tolist() == [0, 1, 0, 1]
    assert frames["marker_error_cm"].tolist() == pytest.approx([1.0, 2.0, 1.1, 2.1])


def test_the_same_table_as_parquet(performed, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    trials = [Trial("a", "seed", str(run.seed), run) for run in runs(0, 7)]
    rows = rows_of(trials, sweep([trial.run for trial in trials], tmp_path))
    table = parquet.read_table(write_table(rows, tmp_path / "t.parquet")).to_pydict()
    assert table["status"] == ["done", "failed"]
    assert table["marker_error_cm"] == [1.0, None]
    assert json.loads(table["inputs"][0])["selected"] == [0]


def test_a_sweep_that_was_interrupted_writes_the_same_table_as_one_that_was_not(performed, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    trials = [Trial("a", "seed", str(run.seed), run) for run in runs(0, 7, 2, frames=(0, 2))]
    tables = []
    for name, steps in (("whole", [3]), ("interrupted", [1, 3])):
        for stop in steps:
            records = sweep([trial.run for trial in trials[:stop]], tmp_path / name)
        table = parquet.read_table(write_table(rows_of(trials, records), tmp_path / name / "t.parquet")).to_pydict()
        tables.append({column: values for column, values in table.items() if column != "seconds"})
    assert tables[0] == tables[1]
    assert tables[0]["frames"] == ["[0, 2]"] * 3


def test_workers_of_a_dask_cluster_share_the_runs(performed, tmp_path):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        records = sweep(runs(0, 1, 13, 2), tmp_path, scheduler=cluster.scheduler_address)
    assert [record["status"] for record in records] == ["done", "done", "failed", "done"]
    assert len(performed) == 4


def test_several_workers_without_dask_are_refused(performed, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match="cluster"):
        sweep(runs(0), tmp_path, workers=3)
    assert len(sweep(runs(0), tmp_path)) == 1
