"""One run at a time in a folder, and nothing lost when it is cut off."""

import subprocess
import sys

import pytest

from jaxmocap._cache import write_records
from jaxmocap._results import InputError
from jaxmocap.pipeline._run_folder import run_folder

HOLD = """
import sys, time
from pathlib import Path
from jaxmocap.pipeline._run_folder import run_folder
with run_folder(Path(sys.argv[1])) as (staging, checkpoint):
    (checkpoint / "state.npz").write_bytes(b"kept")
    print("held", flush=True)
    time.sleep(600)
"""


def begin(out, names=("overlay.mp4",)):
    """A run that is cut off while its files are being published."""
    with run_folder(out) as (_, checkpoint):
        write_records(checkpoint / "state.npz", {})
        for name in names:
            (out / name).write_text("half")
        raise KeyboardInterrupt


def test_a_finished_run_leaves_its_result_alone(tmp_path):
    with run_folder(tmp_path / "out") as (staging, checkpoint):
        (staging / "motion.npz").write_text("result")
        (checkpoint / "state.npz").write_text("kept")
        assert not (tmp_path / "out" / "motion.npz").exists()
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["motion.npz"]


def test_a_run_that_kept_nothing_leaves_nothing(tmp_path):
    with pytest.raises(ValueError, match="early"), run_folder(tmp_path / "out"):
        raise ValueError("early")
    assert not (tmp_path / "out").exists()


def test_an_unfinished_run_is_kept_and_gone_on_with(tmp_path):
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        begin(out)
    with pytest.raises(InputError, match=r"holds an unfinished run; go on with --resume"), run_folder(out):
        pass
    with run_folder(out, resume=True) as (staging, checkpoint):
        assert (checkpoint / "state.npz").is_file()
        (staging / "motion.npz").write_text("result")
        (staging / "overlay.mp4").write_text("whole")
    assert sorted(path.name for path in out.iterdir()) == ["motion.npz", "overlay.mp4"]
    assert (out / "overlay.mp4").read_text() == "whole"


@pytest.mark.parametrize("resume", [False, True])
def test_folders_of_others_are_refused(tmp_path, resume):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "text.tex").write_text("mine")
    with pytest.raises(InputError, match=r"not a result \(text\.tex"), run_folder(tmp_path / "thesis", resume=resume):
        pass
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InputError, match="is a file"), run_folder(tmp_path / "file", resume=resume):
        pass
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "text.tex", "thesis"]


def test_two_runs_do_not_share_a_folder_and_a_killed_one_lets_go(tmp_path):
    out = tmp_path / "out"
    holder = subprocess.Popen([sys.executable, "-c", HOLD, str(out)], stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        for resume in (False, True):
            with pytest.raises(InputError, match="another run is writing to"), run_folder(out, resume=resume):
                pass
    finally:
        holder.kill()
        holder.wait()
    with run_folder(out, resume=True) as (staging, checkpoint):
        assert (checkpoint / "state.npz").read_bytes() == b"kept"
        (staging / "motion.npz").write_text("result")


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"file/out cannot be written"), run_folder(tmp_path / "file" / "out"):
        pass
