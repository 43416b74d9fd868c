import os
from dataclasses import replace

import numpy as np
import pytest
from box_figure import box_character, box_motion

from jaxmocap._files import atomic_folder, atomic_path, claim_output, npz_bytes, write_bytes, write_json
from jaxmocap._results import InputError
from jaxmocap.motion import Motion, _arrays, at_times, read_npz, turned


@pytest.fixture(scope="module")
def motion():
    return box_motion(box_character(), num_frames=3)


@pytest.fixture
def saved(motion, tmp_path):
    return motion.save(tmp_path / "result")


def _rewrite(folder, **changes):
    arrays = read_npz(folder / "motion.npz") | changes
    held = {name: np.asarray(values) for name, values in arrays.items() if values is not None}
    write_bytes(folder / "motion.npz", npz_bytes(held))


def _dies(context, work):
    """Enter `context`, do some work and fail."""
    with context as place:
        work(place)
        raise KeyboardInterrupt


def test_a_folder_without_a_motion_is_not_a_result(tmp_path):
    with pytest.raises(InputError, match=r"is not a result: there is no motion\.npz"):
        Motion.load(tmp_path)


@pytest.mark.parametrize("keep", [0, 1, 100, 5000, -1])
def test_a_truncated_file_is_named(saved, keep):
    path = saved / "motion.npz"
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(InputError, match=r"motion\.npz cannot be read as an npz file"):
        Motion.load(saved)


def test_no_damaged_byte_passes_unnoticed_or_escapes_as_another_error(saved, motion):
    path = saved / "motion.npz"
    data = bytearray(path.read_bytes())
    rng = np.random.default_rng(0)
    for position in rng.integers(0, len(data), 150):
        broken = data.copy()
        broken[position] ^= 0xFF
        path.write_bytes(broken)
        try:
            loaded = Motion.load(path)
        except InputError:
            continue
        assert np.array_equal(loaded.root, motion.root)
        assert np.array_equal(loaded.joints, motion.joints)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"schema_version": 2}, "schema version 2, this jaxmocap reads up to 1; upgrade"),
        ({"schema_version": None}, "has no schema_version"),
        ({"angles": None}, "lacks the array 'angles'"),
        ({"weights": None}, "lacks the array 'weights'"),
        ({"root": np.zeros((3, 3, 3))}, r"root has shape \(3, 3, 3\)"),
        ({"joints": np.full((3, 34, 3), np.nan)}, "joints holds a number that is not finite"),
        ({"faces": np.full((216, 3), 9999)}, r"faces points outside 0\.\.143"),
        ({"vertices": np.full((144, 3), np.nan)}, "vertices holds a number that is not finite"),
        ({"body_parents": np.zeros(18, int)}, "body_parents is not a tree"),
        ({"provenance": "{"}, "is damaged"),
        ({"status": np.arange(3)}, "status holds '0'"),
    ],
)
def test_wrong_contents_are_refused_in_a_sentence(saved, changes, sentence):
    _rewrite(saved, **changes)
    with pytest.raises(InputError, match=sentence):
        Motion.load(saved)


def test_pickles_are_refused(tmp_path):
    np.savez(tmp_path / "motion.npz", schema_version=1, root=np.array([{}], dtype=object))
    with pytest.raises(InputError, match="cannot be read"):
        Motion.load(tmp_path)
    with pytest.raises(TypeError, match="Python objects"):
        npz_bytes({"a": np.array([{}], dtype=object)})


def test_saving_refuses_a_folder_that_holds_a_result(saved, motion):
    before = (saved / "motion.npz").read_bytes()
    with pytest.raises(InputError, match="already holds the result of another run"):
        motion.save(saved)
    motion[:2].save(saved, overwrite=True)
    assert (saved / "motion.npz").read_bytes() != before
    assert len(Motion.load(saved)) == 2


def test_a_full_disk_leaves_no_result(motion, tmp_path, monkeypatch):
    def fail(path):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("jaxmocap._files._atomic._flush", fail)
    with pytest.raises(InputError, match="No space left"):
        motion.save(tmp_path / "result")
    assert list(tmp_path.iterdir()) == []


def test_how_long_it_took_is_in_the_report_alone(motion, tmp_path):
    """Two runs of the same give the same `motion.npz`, and each still knows its time."""
    files = []
    for seconds in (1.0, 2.0):
        timed = replace(
            motion, provenance={**motion.provenance, "seconds": {"track": seconds}, "seconds_per_frame": seconds}
        )
        files.append(timed.save(tmp_path / str(seconds)) / "motion.npz")
        assert Motion.load(tmp_path / str(seconds)).provenance == timed.provenance
    assert files[0].read_bytes() == files[1].read_bytes()
    for broken in ("{", "[]", '{"provenance": 3}'):
        (tmp_path / "1.0" / "report.json").write_text(broken)
        assert Motion.load(tmp_path / "1.0").provenance == motion.provenance


def test_the_covariance_is_kept_and_follows_the_world(motion, tmp_path):
    spread = np.diag([1e-4, 4e-4, 9e-4]) + np.zeros((*motion.joints.shape, 3))
    sure = replace(motion, covariance=spread)
    loaded = Motion.load(sure.save(tmp_path / "sure"))
    np.testing.assert_array_equal(loaded.covariance, sure.covariance)
    assert loaded[1:].covariance.shape[0] == len(motion) - 1
    np.testing.assert_allclose(turned(loaded, "z").covariance[0, 0], np.diag([1e-4, 9e-4, 4e-4]), atol=1e-9)
    aside = turned(loaded, "x")
    np.testing.assert_allclose(aside.joints[..., 0], loaded.joints[..., "xyz".index(loaded.up)], atol=1e-6)
    np.testing.assert_allclose(turned(aside, loaded.up).joints, loaded.joints, atol=1e-6)
    halfway = at_times(loaded, loaded.timestamps[:-1] + 0.01).covariance
    np.testing.assert_allclose(halfway[0, 0], spread[0, 0], atol=1e-9)
    with pytest.raises(InputError, match="covariance has shape"):
        replace(motion, covariance=spread[:, :2])
    assert Motion.load(motion.save(tmp_path / "unsure")).covariance is None


def test_the_misfit_of_the_character_is_kept_and_0_in_older_results(motion, tmp_path):
    made = replace(motion, character=replace(motion.character, misfit=0.01))
    folder = made.save(tmp_path / "made")
    assert float(Motion.load(folder).character.misfit) == pytest.approx(0.01)
    _rewrite(folder, misfit=None)
    assert float(Motion.load(folder).character.misfit) == 0


def test_an_interrupted_write_keeps_the_old_file(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"a": 1})
    before = path.read_bytes()
    with pytest.raises(KeyboardInterrupt):
        _dies(atomic_path(path), lambda temporary: temporary.write_text("half"))
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["a.json"]


def test_json_has_no_numbers_that_json_does_not_know(tmp_path):
    write_json(tmp_path / "a.json", {"a": np.array([1.5, np.nan]), "b": (np.int64(2), float("inf")), "c": tmp_path})
    assert (tmp_path / "a.json").read_text().replace("\n", "").replace(" ", "") == (
        f'{{"a":[1.5,null],"b":[2,null],"c":"{tmp_path}"}}'
    )
    with pytest.raises(TypeError, match="cannot be written as JSON"):
        write_json(tmp_path / "b.json", {"a": object()})
    assert os.listdir(tmp_path) == ["a.json"]


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        _dies(atomic_folder(tmp_path / "out"), lambda folder: (folder / "one").write_text("1"))
    assert os.listdir(tmp_path) == []
    with atomic_folder(tmp_path / "out") as folder:
        (folder / "one").write_text("1")
        assert not (tmp_path / "out").exists()
    assert os.listdir(tmp_path) == ["out"]
    with pytest.raises(OSError, match="not empty"), atomic_folder(tmp_path / "out"):
        pass
    assert (tmp_path / "out/one").read_text() == "1"


def test_a_claimed_folder_is_filled_at_the_end(motion, tmp_path):
    out = tmp_path / "deep/out"
    with claim_output(out) as staging:
        motion.save(staging)
        (staging / "overlay.mp4").write_bytes(b"video")
        assert not (out / "motion.npz").exists()
    assert sorted(os.listdir(out)) == ["motion.npz", "overlay.mp4", "report.json"]


def test_a_failed_run_leaves_nothing(motion, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        _dies(claim_output(tmp_path / "out"), motion.save)
    assert os.listdir(tmp_path) == []


def test_a_failed_run_keeps_its_checkpoint_and_what_was_there(motion, tmp_path):
    out = tmp_path / "out"
    checkpoint = lambda _: write_bytes(out / "checkpoint.npz", npz_bytes({"frame": np.arange(2)}))  # noqa: E731
    with pytest.raises(KeyboardInterrupt):
        _dies(claim_output(out, keep=("checkpoint.npz",)), checkpoint)
    assert os.listdir(out) == ["checkpoint.npz"]
    with pytest.raises(InputError, match=r"not a result \(checkpoint\.npz"), claim_output(out):
        pass
    with claim_output(out, keep=("checkpoint.npz",)) as staging:
        motion.save(staging)
    assert len(Motion.load(out)) == 3


def test_results_files_and_foreign_folders_are_refused_before_any_work(saved, motion, tmp_path):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis/chapter.tex").write_text("1")
    (tmp_path / "file").write_text("1")
    for path, sentence in (
        (saved, "already holds the result of another run"),
        (tmp_path / "thesis", "files that are not a result"),
        (tmp_path / "file", "is a file"),
        (tmp_path / "file/below", "cannot be written"),
    ):
        with pytest.raises(InputError, match=sentence), claim_output(path):
            pytest.fail("was not refused")
    with (
        pytest.raises(InputError, match="files that are not a result"),
        claim_output(tmp_path / "thesis", overwrite=True),
    ):
        pytest.fail("was not refused")
    assert os.listdir(tmp_path / "thesis") == ["chapter.tex"]


def test_what_file_managers_leave_and_what_nothing_replaces_is_in_nobody_s_way(motion, tmp_path):
    (tmp_path / ".DS_Store").write_text("1")
    with claim_output(tmp_path) as staging:
        motion.save(staging)
        (tmp_path / "notes.txt").write_text("mine")
    assert sorted(os.listdir(tmp_path)) == [".DS_Store", "motion.npz", "notes.txt", "report.json"]
    out = tmp_path / "other"
    claim = claim_output(out)
    motion.save(claim.__enter__())
    (out / "report.json").write_text("mine")
    with pytest.raises(InputError, match=r"not a result \(report\.json"):
        claim.__exit__(None, None, None)
    assert (out / "report.json").read_text() == "mine"


def test_overwriting_replaces_the_result_and_a_failure_keeps_it(saved, motion):
    before = (saved / "motion.npz").read_bytes()
    with pytest.raises(KeyboardInterrupt):
        _dies(claim_output(saved, overwrite=True), motion[:1].save)
    assert (saved / "motion.npz").read_bytes() == before
    with claim_output(saved, overwrite=True) as staging:
        motion[:1].save(staging)
    assert len(Motion.load(saved)) == 1
    assert sorted(os.listdir(saved)) == ["motion.npz", "report.json"]


def test_two_runs_into_one_folder_do_not_mix(motion, tmp_path):
    first, second = claim_output(tmp_path / "out"), claim_output(tmp_path / "out")
    first_staging = first.__enter__()
    motion.save(first_staging)
    with second as staging:
        motion[:2].save(staging)
    with pytest.raises(InputError, match="result of another run"):
        first.__exit__(None, None, None)
    assert len(Motion.load(tmp_path / "out")) == 2


def test_the_schema_in_the_text_is_the_schema_on_disk(saved):
    text = _arrays.__doc__
    for name in read_npz(saved / "motion.npz"):
        assert name in text or name.startswith("energy_"), name
