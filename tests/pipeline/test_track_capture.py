"""From a capture folder to a result folder."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from golden import hold_against_golden

from jaxmocap._results import InputError
from jaxmocap.metrics import evaluate
from jaxmocap.motion import Motion
from jaxmocap.pipeline import track_capture
from jaxmocap.synthetic import make_capture, write_capture

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_capture(make_capture(6, (320, 180)), tmp_path_factory.mktemp("capture") / "six")


@pytest.fixture(scope="module")
def programs():
    """What is being done whenever a program is compiled or taken from the cache."""
    doing, found = [None], []

    def listen(event: str, _: float, **about) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            found.append((doing[-1], about.get("fun_name")))

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield doing, found
    jax.monitoring.unregister_event_duration_listener(listen)


@pytest.fixture(scope="module")
def result(folder, tmp_path_factory, programs):
    told = programs[0]
    out = tmp_path_factory.mktemp("result") / "first"
    motion = track_capture(folder, out, quality="draft", progress=lambda *step: told.append(step))
    return motion, out, told


def test_markers_are_found_to_three_centimetres(folder, result):
    scores = evaluate(result[1], folder / "truth.npz")
    assert scores["frames"] == 6
    assert scores["lost_frames"] == 0
    assert scores["marker_error_cm"]["mean"] < 3.0


def test_nothing_is_compiled_once_the_sequence_runs(result, programs):
    """`told` says how many frames are done: the flow start needs one, the motion prior two."""
    tracked = [(step[1], name) for step, name in programs[1] if step is not None and step[0] == "track"]
    assert any(done < 3 for done, _ in tracked)
    assert not [(done, name) for done, name in tracked if 3 <= done < 6]


def test_the_folder_holds_the_result(result):
    motion, out, told = result
    names = {path.name for path in out.iterdir()}
    assert {"motion.npz", "report.json", "registration.json"} <= names
    assert sum(name.endswith(".mp4") for name in names) == 2
    assert not [path for path in out.parent.iterdir() if path != out]
    loaded = Motion.load(out)
    np.testing.assert_array_equal(loaded.angles, motion.angles)
    np.testing.assert_array_equal(loaded.frames, np.arange(6))
    assert set(loaded.status) <= {"ok", "doubtful", "lost"}
    assert set(loaded.energy) == {"model_view", "view_view", "posture", "covered"}
    assert all(np.all(np.isfinite(values)) for values in loaded.energy.values())
    assert ("track", 6, 6) in told


def test_the_result_is_as_good_as_the_golden_one(folder, result):
    hold_against_golden(result[0], folder / "truth.npz", "synthetic")


def test_the_same_seed_gives_the_same_bytes(folder, result, tmp_path):
    motion = result[0]
    again = track_capture(folder, tmp_path / "second", quality="draft", overlays=False)
    assert again.root.tobytes() == motion.root.tobytes()
    assert again.angles.tobytes() == motion.angles.tobytes()


@pytest.mark.parametrize(
    ("late", "cut"),
    [(False, ("track", 1)), (False, ("track", 4)), (False, ("clip", 2)), (True, ("track", 2)), (True, ("track", 4))],
)
def test_a_run_that_was_cut_off_goes_on_to_the_same_file(tmp_path, late, cut):
    """Also one that runs backwards from a late selected frame, cut off in either direction, and one that was all
    tracked when it was cut off."""
    truth = make_capture(5, (320, 180), selected_frames=(2,) if late else (0,))
    folder = write_capture(truth, tmp_path / "film")

    def run(name, progress=None, **options):
        told = {"quality": "draft", "settings": {"clip.flow": "true"}, "progress": progress}
        track_capture(folder, tmp_path / name, overlays=False, **told, **options)
        return (tmp_path / name / "motion.npz").read_bytes()

    def cut_off(stage, frames, _):
        if (stage, frames) == cut:
            raise KeyboardInterrupt

    whole, said = run("whole"), []
    with pytest.raises(KeyboardInterrupt):
        run("cut", cut_off, say=said.append)
    assert "the same command with --resume goes on" in said[-1]
    assert not (tmp_path / "cut" / "motion.npz").exists()
    with pytest.raises(InputError, match="holds an unfinished run; go on with --resume"):
        run("cut")
    with pytest.raises(InputError, match="was begun with another seed;"):
        run("cut", resume=True, seed=1)
    assert run("cut", resume=True) == whole
    (tmp_path / "cut" / "report.html").unlink()  # as a kill between the result and its page leaves it
    assert run("cut", resume=True, progress=cut_off) == whole, "a finished run is read, not repeated"
    assert (tmp_path / "cut" / "report.html").is_file()
    with pytest.raises(InputError, match="the result of another quality and settings;"):
        track_capture(folder, tmp_path / "cut", resume=True)
    assert not (tmp_path / "cut" / "checkpoint").exists()


def test_what_was_kept_from_an_earlier_run_changes_nothing(folder, result, tmp_path):
    """The first run made the stages; this one makes them again, and the next takes them from the cache."""
    told = []
    for cache in (False, True):
        out = tmp_path / str(cache)
        told.append([])
        track_capture(
            folder, out, quality="draft", overlays=False, cache=cache, progress=lambda *step: told[-1].append(step[0])
        )
        assert (out / "motion.npz").read_bytes() == (result[1] / "motion.npz").read_bytes()
    assert "register" in told[0]
    assert "register" not in told[1]


def test_a_folder_that_holds_a_result_is_not_written_into(folder, result):
    before = {path.name: path.stat().st_mtime_ns for path in result[1].iterdir()}
    with pytest.raises(InputError, match="first"):
        track_capture(folder, result[1], quality="draft")
    assert {path.name: path.stat().st_mtime_ns for path in result[1].iterdir()} == before


def test_a_range_that_begins_before_the_selected_frames_is_tracked_backwards(tmp_path):
    truth = make_capture(4, (320, 180), selected_frames=(2,))
    folder = write_capture(truth, tmp_path / "late")
    motion = track_capture(folder, tmp_path / "out", quality="draft", frames=(1, 4), overlays=False)
    np.testing.assert_array_equal(motion.frames, [1, 2, 3])
    joints = jnp.asarray(motion.joints)
    assert joints.shape[0] == 3
    scores = evaluate(tmp_path / "out", folder / "truth.npz")
    assert scores["marker_error_cm"]["mean"] < 4.0


def test_a_failure_leaves_nothing_behind(folder, tmp_path):
    with pytest.raises(InputError, match="frames 4:9 are asked for, but capture 'synthetic' has frames 0:6"):
        track_capture(folder, tmp_path / "out", quality="draft", frames=(4, 9))
    assert list(tmp_path.iterdir()) == []
