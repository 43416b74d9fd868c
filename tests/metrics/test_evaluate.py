import io
import json
import os
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from box_figure import box_character, box_motion
from rich.console import Console
from scipy.spatial.transform import Rotation

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras
from jaxmocap.metrics import Similarity, Truth, evaluate, evaluation_table, jitter, silhouette_iou

CHARACTER = box_character()
NAMES = ("pelvis", "neck", "head", "l_wrist", "r_ankle", "nose")


def _motion(**fields):
    return box_motion(CHARACTER, num_frames=8, **fields)


@pytest.fixture(scope="module")
def motion():
    return _motion(status=["ok"] * 6 + ["lost"] * 2, provenance={"seconds_per_frame": 1.25})


def _truth(motion):
    vertices = np.stack([motion.vertices(index) for index in range(len(motion))])
    joints = motion.joints[:, [motion.joint_names.index(name) for name in NAMES]]
    markers = vertices[:, [0, 9, 40, 80, 143]].astype(np.float64)
    return {"markers": markers, "joints": joints.astype(np.float64), "joint_names": np.array(NAMES), "fps": 30}


def _write(path, arrays):
    np.savez(path, **arrays)
    return path


def test_the_json_has_the_keys_others_rely_on(motion, tmp_path):
    motion.save(tmp_path / "result")
    scores = evaluate(tmp_path / "result", _write(tmp_path / "truth.npz", _truth(motion)))
    scores = json.loads(json.dumps(scores, allow_nan=False))
    assert scores["frames"] == 8
    assert scores["lost_frames"] == 2
    assert set(scores["marker_error_cm"]) == {"mean", "min", "max", "p95"}
    for key in ("joint_error_cm", "joint_error_offset_corrected_cm"):
        assert set(scores[key]) == {"mean", "p95", "max"}
    assert scores["pa_mpjpe_cm"] == pytest.approx(0, abs=1e-3)
    assert scores["seconds_per_frame"] == 1.25
    assert scores["marker_error_cm"]["max"] == pytest.approx(0, abs=1e-3)
    assert len(scores["marker_error_per_frame_cm"]) == 8
    assert "aligned_by" not in scores


def test_errors_are_centimetres(motion, tmp_path):
    truth = _truth(motion)
    truth["markers"][1:] += [0, 0.03, 0.04]
    truth["joints"] += [0.06, 0.08, 0]
    scores = evaluate(motion, _write(tmp_path / "truth.npz", truth))
    assert scores["marker_error_cm"] == pytest.approx({"mean": 5 * 7 / 8, "min": 0, "max": 5, "p95": 5}, abs=1e-3)
    assert scores["joint_error_cm"] == pytest.approx({"mean": 10, "p95": 10, "max": 10}, abs=1e-3)


def test_joints_that_rigs_place_differently_are_left_out_of_the_mean_unless_asked_for(motion, tmp_path):
    """Every true joint is off by one centimetre, but the pelvis by 6 and the head by 12."""
    truth = _truth(motion)
    truth["joints"] += np.array([0.06, 0.01, 0.12, 0.01, 0.01, 0.01])[:, None] * [0, 1, 0]
    path = _write(tmp_path / "truth.npz", truth)
    scores = evaluate(motion, path)
    assert scores["joint_error_cm"]["mean"] == pytest.approx(1, abs=1e-3)
    assert set(scores["joints_scored"]) == set(scores["joint_error_by_name_cm"]) == {"neck", "l_wrist", "r_ankle"}
    assert scores["joints_left_out"] == pytest.approx({"pelvis": 6, "head": 12, "nose": 1}, abs=1e-3)
    assert "left out of the mean: pelvis 6.00 cm, head 12.00 cm, nose 1.00 cm" in _printed(scores)

    every = evaluate(motion, path, joints="all")
    assert every["joint_error_cm"]["mean"] == pytest.approx((6 + 12 + 3) / 5, abs=1e-3)
    assert every["joints_left_out"] == pytest.approx({"nose": 1}, abs=1e-3)
    named = evaluate(motion, path, joints=["nose", "head"])
    assert named["joint_error_cm"]["mean"] == pytest.approx(6.5, abs=1e-3)

    ours = evaluate(motion, _write(tmp_path / "ours.npz", truth | {"joint_definitions": "jaxmocap"}))
    assert ours["joint_error_cm"] == every["joint_error_cm"]


def test_keys_the_truth_cannot_answer_are_absent(motion, tmp_path):
    truth = _truth(motion)
    only_joints = evaluate(motion, _write(tmp_path / "joints.npz", {k: v for k, v in truth.items() if k != "markers"}))
    assert "marker_error_cm" not in only_joints
    assert "joint_error_cm" in only_joints
    only_markers = evaluate(_motion(), _write(tmp_path / "markers.npz", {"markers": truth["markers"]}))
    assert "marker_error_cm" in only_markers
    assert not {"joint_error_cm", "pa_mpjpe_cm", "seconds_per_frame"} & set(only_markers)


@pytest.mark.filterwarnings("error")
def test_names_as_bytes_and_a_pelvis_that_is_never_seen_are_scored(motion, tmp_path):
    truth = _truth(motion)
    truth["joints"][:, 0] = np.nan
    path = _write(tmp_path / "truth.npz", truth | {"joint_names": np.array(NAMES, "S")})
    scores = evaluate(motion, path, joints="all")
    assert scores["joint_error_cm"]["max"] == pytest.approx(0, abs=1e-3)
    assert "mpjpe_root_aligned_cm" not in scores


def test_a_part_of_the_frames_is_matched_by_time(motion, tmp_path):
    path = _write(tmp_path / "truth.npz", _truth(motion))
    scores = evaluate(motion[3:6], path)
    assert scores["frames"] == 3
    assert scores["lost_frames"] == 0
    assert scores["joint_error_cm"]["max"] == pytest.approx(0, abs=1e-3)
    assert scores["marker_error_cm"]["max"] == pytest.approx(0, abs=1e-3)


def test_dropped_frames_do_not_shift_the_rest(motion, tmp_path):
    """The video lost frame 2: from there its frame numbers lag behind, its timestamps do not."""
    path = _write(tmp_path / "truth.npz", _truth(motion))
    kept = motion[np.array([0, 1, 3, 4, 5])]
    renumbered = type(kept)(**{**vars(_plain(kept)), "frames": np.arange(5)})
    assert evaluate(renumbered, path)["joint_error_cm"]["max"] == pytest.approx(0, abs=1e-3)


def test_times_that_a_container_rounded_are_those_of_the_truth(tmp_path):
    """Matroska counts milliseconds: of 59.94 frames a second each is up to 3 % of an interval early or late."""
    motion = box_motion(CHARACTER, num_frames=40)
    told = type(motion)(**{**vars(_plain(motion)), "timestamps": np.round(np.arange(40) / 59.94, 3)})
    scores = evaluate(told, _write(tmp_path / "truth.npz", _truth(motion) | {"fps": 59.94}))
    assert scores["joint_error_cm"]["max"] == pytest.approx(0, abs=1e-3)
    assert scores["acceleration_error_m_per_s2"] == pytest.approx(0, abs=0.01)


def _plain(motion):
    """The motion without what it has cached."""
    for name in ("pose_vectors", "body_transforms"):
        motion.__dict__.pop(name, None)
    return motion


def test_a_truth_at_another_rate_is_interpolated(motion, tmp_path):
    truth = _truth(motion)
    for name in ("markers", "joints"):
        dense = np.empty((15, *truth[name].shape[1:]))
        dense[::2], dense[1::2] = truth[name], (truth[name][1:] + truth[name][:-1]) / 2
        truth[name] = dense
    scores = evaluate(motion, _write(tmp_path / "truth.npz", truth | {"fps": 60}))
    assert scores["frames"] == 8
    assert scores["joint_error_cm"]["max"] == pytest.approx(0, abs=1e-3)


def test_frames_beyond_the_truth_are_counted_and_left_out(motion, tmp_path):
    truth = _truth(motion)
    short = truth | {name: truth[name][:5] for name in ("markers", "joints")}
    scores = evaluate(motion, _write(tmp_path / "truth.npz", short))
    assert (scores["frames"], scores["frames_without_truth"]) == (5, 3)
    assert scores["frame_numbers"] == [0, 1, 2, 3, 4]
    with pytest.raises(InputError, match="share none, so this is the truth of another capture"):
        evaluate(motion[5:], tmp_path / "truth.npz")


def test_frames_in_a_hole_of_the_truth_are_counted_and_left_out(tmp_path):
    """Between samples 1 and 18 nothing is known; of single moments, a third of a second apart, nothing between them."""
    motion = box_motion(CHARACTER, num_frames=20)
    for kept in ([0, 1, 18, 19], [0, 10, 19]):
        truth = {name: values[kept] for name, values in _truth(motion).items() if name in ("markers", "joints")}
        truth |= {"joint_names": np.array(NAMES), "timestamps": motion.timestamps[kept]}
        path = _write(tmp_path / "truth.npz", truth)
        scores = evaluate(motion, path)
        assert scores["frame_numbers"] == kept
        assert scores["frames_without_truth"] == 20 - len(kept)
        assert scores["marker_error_cm"]["max"] == pytest.approx(0, abs=1e-3)
        assert scores["jitter_m_per_s2"] == jitter(motion)
        with pytest.raises(InputError, match="no samples at the result's frames"):
            evaluate(motion[3:6], path)


def test_a_result_in_its_own_world_is_aligned_once_by_the_cameras(tmp_path):
    rng = np.random.default_rng(5)
    ours = np.tile(np.eye(4), (2, 8, 1, 1))
    ours[..., :3, :3] = Rotation.random(16, rng=rng).as_matrix().reshape(2, 8, 3, 3)
    ours[..., :3, 3] = 3 * rng.standard_normal((2, 8, 3))
    placed = Similarity(0.5, Rotation.from_rotvec([2, -1, 0.5]).as_matrix(), np.array([1.0, 2.0, 3.0]))
    theirs = ours.copy()
    centres = -np.einsum("ctji,ctj->cti", ours[..., :3, :3], ours[..., :3, 3])
    theirs[..., :3, :3] = ours[..., :3, :3] @ placed.rotation.T
    theirs[..., :3, 3] = -np.einsum("ctij,ctj->cti", theirs[..., :3, :3], placed(centres))
    cameras = Cameras(
        names=("a", "b"),
        sizes=((64, 48), (64, 48)),
        intrinsics=jnp.tile(jnp.eye(3), (2, 1, 1)),
        distortion=jnp.zeros((2, 5)),
        cam_from_world=jnp.asarray(ours, jnp.float32),
    )
    motion = _motion(cameras=cameras)
    truth = _truth(motion)
    truth |= {"markers": placed(truth["markers"]), "joints": placed(truth["joints"]) + [0.1, 0, 0]}
    path = _write(tmp_path / "truth.npz", truth | {"cam_from_world": theirs})
    motion[2:].save(tmp_path / "result")
    scores = evaluate(tmp_path / "result", path)
    assert scores["marker_error_cm"]["max"] == pytest.approx(0, abs=2e-3)
    assert scores["joint_error_cm"]["mean"] == pytest.approx(10, abs=1e-2)
    assert scores["aligned_by"] == "one similarity over 12 camera poses"
    assert scores["alignment"]["scale"] == pytest.approx(0.5, abs=1e-5)
    assert scores["alignment"]["camera_centre_residual_cm"] < 1e-2
    assert "holds none" in evaluate(_motion(), path)["aligned_by"]
    theirs[1, 2:4, 0, 0] = np.nan
    assert evaluate(motion, _write(tmp_path / "gaps.npz", truth | {"cam_from_world": theirs}))["aligned_by"] == (
        "one similarity over 14 camera poses"
    )
    with pytest.raises(InputError, match="cam_from_world is known in none of the evaluated frames"):
        evaluate(motion, _write(tmp_path / "none.npz", truth | {"cam_from_world": np.full_like(theirs, np.nan)}))
    three = np.concatenate([theirs, theirs[:1]])
    with pytest.raises(InputError, match=r"result has 2 cameras, the truth .* has 3"):
        evaluate(motion, _write(tmp_path / "three.npz", truth | {"cam_from_world": three}))


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"markers": None, "joints": None}, "neither markers nor joints"),
        ({"markers": np.zeros((8, 5))}, r"markers has shape \(8, 5\)"),
        ({"markers": np.zeros((7, 5, 3))}, "different numbers of frames: 7 of markers, 8 of joints"),
        ({"joint_names": np.array(["pelvis"])}, "6 joints and 1 joint_names"),
        ({"joint_names": np.array(list("abcdef"))}, "no name in common"),
        ({"fps": 0}, "fps is 0"),
        ({"joint_definitions": "COCO"}, "joint_definitions is 'COCO'; 'jaxmocap' was expected"),
        ({"timestamps": np.zeros(8)}, "timestamps do not increase"),
        ({"cam_from_world": np.zeros((2, 8, 3))}, "cam_from_world has shape"),
        ({"markers": np.array([["a"]])}, "markers has shape"),
        ({"cam_from_world": np.full((2, 8, 4, 4), "a")}, r"cam_from_world has shape .* numbers were expected"),
        ({"timestamps": np.array(list("abcdefgh"))}, "timestamps are of type <U1; numbers, seconds, were expected"),
        ({"joint_names": np.array("pelvis")}, "6 joints and 1 joint_names"),
    ],
)
def test_unusable_truths_are_refused_in_a_sentence(motion, tmp_path, changes, sentence):
    arrays = {name: value for name, value in (_truth(motion) | changes).items() if value is not None}
    with pytest.raises(InputError, match=sentence):
        evaluate(motion, _write(tmp_path / "truth.npz", arrays))


def test_missing_and_damaged_truths_are_refused(motion, tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        Truth.read(tmp_path / "truth.npz")
    (tmp_path / "truth.npz").write_bytes(b"PK not a zip")
    with pytest.raises(InputError, match="cannot be read"):
        evaluate(motion, tmp_path / "truth.npz")
    np.save(tmp_path / "array.npy", np.zeros(3))
    with pytest.raises(InputError, match="holds a single array"):
        evaluate(motion, tmp_path / "array.npy")


def test_points_on_the_surface_are_counted_in_the_caption_and_the_worst_is_named(motion, tmp_path):
    """The pelvis is off by 6 cm, the nose by 2, a toe by 3; the other points are true."""
    names = ("neck", "pelvis", "nose", "l_toe", "r_heel")
    places = motion.joints[:, [motion.joint_names.index(name) for name in names]].astype(np.float64)
    places += np.array([0, 0.06, 0.02, 0.03, 0])[:, None] * [0, 1, 0]
    path = _write(tmp_path / "truth.npz", {"joints": places, "joint_names": np.array(names), "fps": 30})
    scores = evaluate(motion, path)
    assert scores["joints_left_out"] == pytest.approx(dict(zip(names[1:], (6, 2, 3, 0), strict=True)), abs=1e-3)
    said = "left out of the mean: pelvis 6.00 cm, 3 points on the surface, at worst l_toe 3.00 cm (--json has all)"
    text = _printed(scores)
    assert said in text
    assert "nose" not in text

    every = _printed(evaluate(motion, path, joints="all"))
    assert "left out of the mean: 3 points on the surface, at worst l_toe 3.00 cm" in every


def _printed(scores):
    """The table as text, its lines joined."""
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(evaluation_table(scores))
    return " ".join(console.export_text().split())


def test_the_uncertainty_of_two_seeds_of_a_capture_is_told_apart(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    import uncertainty

    path = _write(tmp_path / "truth.npz", _truth(_motion()))
    covariance = np.broadcast_to(1e-4 * np.eye(3, dtype=np.float32), (*_motion().joints.shape, 3))
    about = {"truth": str(path), "capture_name": "plaza"}
    folders = [str(_motion(covariance=covariance, provenance=about).save(tmp_path / f"seed{n}")) for n in range(2)]
    monkeypatch.setattr("sys.argv", ["uncertainty.py", *folders, "--out", str(tmp_path / "figures.json")])
    assert uncertainty.main() == 0
    figures = json.loads((tmp_path / "figures.json").read_text())["figures"]
    assert len({figure["metric"] for figure in figures}) == len(figures) == 14


def test_the_table_shows_every_error(motion, tmp_path):
    scores = evaluate(motion, _write(tmp_path / "truth.npz", _truth(motion)))
    text = _printed(scores | {"marker_error_cm": {"mean": 4.23, "min": 2.48, "max": 6.2, "p95": 9.0}})
    for expected in ("4.23", "2.48", "6.20", "9.00", "8 frames, 2 lost; 1.25 s per frame", "after Procrustes"):
        assert expected in text


def test_silhouette_overlap():
    a, b = np.zeros((4, 6), bool), np.zeros((4, 6), bool)
    assert silhouette_iou(a, b) == 1
    a[:2], b[1:3] = True, True
    assert silhouette_iou(a, b) == pytest.approx(1 / 3)
    with pytest.raises(ValueError, match="shapes"):
        silhouette_iou(a, b[:2])


@pytest.mark.parametrize("name", ["plaza", "plaza_raw", "street", "balance"])
def test_the_truths_of_the_example_captures_are_read(name):
    path = Path(os.environ.get("JAXMOCAP_DATA", Path(__file__).parents[3] / "shared/data")) / name / "truth.npz"
    if not path.exists():
        pytest.skip(f"{path} is not here")
    truth = Truth.read(path)
    assert truth.joints.shape[:2] == (len(truth.times), len(truth.joint_names))
    assert (truth.markers is None) == (name == "balance")
    assert (truth.cam_from_world is None) == (name != "plaza_raw")
    assert np.isclose(truth.times[1], 1 / 60 if name == "balance" else 1 / 30)
    assert len({"neck", "l_shoulder", "r_ankle"} & set(truth.joint_names) & set(CHARACTER.skeleton.landmark_names)) == 3


def test_worlds_without_common_cameras_are_aligned_by_the_joints_of_all_frames(motion, tmp_path):
    truth = _truth(motion)
    turn = Rotation.from_rotvec([0.3, -1.0, 0.2]).as_matrix()
    for name in ("markers", "joints"):
        truth[name] = 1.1 * truth[name] @ turn.T + [3.0, 0.5, -2.0]
    path = _write(tmp_path / "truth.npz", truth)
    apart, aligned = evaluate(motion, path), evaluate(motion, path, align="joints")
    assert apart["joint_error_cm"]["mean"] > 100
    assert aligned["joint_error_cm"]["max"] == pytest.approx(0, abs=1e-3)
    assert aligned["marker_error_cm"]["max"] == pytest.approx(0, abs=1e-3)
    assert aligned["alignment"]["scale"] == pytest.approx(1.1)
    assert aligned["aligned_by"].startswith("one similarity over 24 joints")


def test_a_truth_without_joints_cannot_be_aligned_by_them(motion, tmp_path):
    path = _write(tmp_path / "truth.npz", {"markers": _truth(motion)["markers"]})
    with pytest.raises(InputError, match="holds no joints to align by"):
        evaluate(motion, path, align="joints")
