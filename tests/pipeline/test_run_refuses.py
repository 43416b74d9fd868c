"""What `run` refuses before anything is done, and whose folders it leaves alone."""

import shutil
from types import SimpleNamespace

import pytest
from small_captures import make_video
from stand_ins import STAGES, VIDEO, again, make_folder

from jaxmocap._cli import run as command
from jaxmocap._results import InputError
from jaxmocap.detection import Weights, _weights
from jaxmocap.pipeline import _run_files, run


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
        ({"scan": "walk.mp4", "height": None}, "--scan does not tell how large the person is; .* --camera-distance"),
    ],
)
def test_what_cannot_work_is_refused_before_anything_is_done(options, words, clips, done, tmp_path):
    with pytest.raises(InputError, match=words):
        run(clips, tmp_path / "dance", **({"height": 1.8} | options))
    assert list(tmp_path.iterdir()) == []


def test_videos_that_cannot_be_used_are_refused(clips, done, tmp_path):
    broken = tmp_path / "broken.mp4"
    broken.write_bytes(clips[0].read_bytes()[:300])
    for given, words in (
        ([], "no video is given"),
        ([clips[0], broken], "broken.mp4"),
        ([clips[0], tmp_path / "gone.mp4"], "gone.mp4"),
        ([clips[0], clips[0]], "given twice"),
        (
            [clips[0], shutil.copy(clips[0], tmp_path / "copy.mp4")],
            r"left\.mp4 and .*copy\.mp4 are the same film",
        ),
        (clips[0].with_name("lone.mp4"), r"lone\.mp4 does not exist"),
        (str(clips[0].with_name("lone.mp4")), r"lone\.mp4 does not exist"),
        ([tmp_path], "is a folder; the file of a video was expected"),
        ([clips[0], make_video(tmp_path / "photo.mp4", 1)], r"photo\.mp4 holds one picture"),
    ):
        with pytest.raises(InputError, match=words):
            run(given, tmp_path / "dance", height=1.8)
    assert not (tmp_path / "dance").exists()


def test_frames_the_wrong_way_round_are_refused(clips, tmp_path, done):
    with pytest.raises(InputError, match=r"frames 8:3 were asked for, but left.mp4 has 12 frames, 0 to 11"):
        run(clips, tmp_path / "dance", height=1.8, frames=(8, 3))
    assert not (tmp_path / "dance").exists()


def test_frames_that_are_not_shared_are_refused_before_anybody_is_looked_for(clips, done, tmp_path):
    told = {"offset": {"right_hand": 0.2}, "frames": (0, 12)}
    for _ in range(2):
        with pytest.raises(
            InputError, match=r"frames 0:12 were asked for, but the videos share \d frames, .* --frames"
        ):
            run(clips, tmp_path / "dance", height=1.8, **told)
    assert done == []


@pytest.mark.parametrize(
    ("option", "name", "words"),
    [
        ("actor", "me.obj", r"me\.obj cannot be read as a mesh|me\.obj holds no triangles"),
        ("actor", "me.glb", r"me\.glb"),
        ("actor", "me.txt", r"me\.txt is not a known kind of mesh"),
        ("scan", "walk.mp4", r"walk\.mp4"),
    ],
)
def test_an_actor_or_a_scan_that_is_none_is_refused_before_anything_is_done(option, name, words, clips, done, tmp_path):
    (tmp_path / name).write_text("mine")
    with pytest.raises(InputError, match=words):
        run(clips, tmp_path / "dance", **{"height": 1.8, option: tmp_path / name})
    assert (done, (tmp_path / "dance").exists()) == ([], False)
    (tmp_path / "pictures").mkdir()
    with pytest.raises(InputError, match="pictures holds no pictures"):
        run(clips, tmp_path / "dance", height=1.8, scan=tmp_path / "pictures")


@pytest.fixture
def real_weights(monkeypatch):
    """Weights are looked for as ever, but not downloaded."""
    monkeypatch.setattr(_run_files, "get_weights", _weights.get_weights)
    monkeypatch.setattr(_weights.shutil, "which", lambda name: None)
    failed = SimpleNamespace(returncode=1, stderr="no network")
    monkeypatch.setattr(_weights, "subprocess", SimpleNamespace(run=lambda *_, **__: failed))


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
    make, words, clips, done, real_weights, tmp_path, capsys
):
    make(tmp_path / "weights")
    out, weights = tmp_path / "dance", tmp_path / "weights"
    with pytest.raises(InputError, match=words):
        run(clips, out, height=1.8, weights=weights)
    assert command(["run", *map(str, clips), "--height", "1.8", "--out", str(out), "--weights", str(weights)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert (done, out.exists()) == ([], False)


def test_a_bundle_of_other_networks_is_refused_before_anything_is_done(clips, done, monkeypatch, tmp_path):
    pytest.importorskip("ai_edge_litert", reason="the extra 'detect' is not installed")
    given = Weights("heavy", {"person": b"no network", "landmarks": b"no network"})
    monkeypatch.setattr(_run_files, "get_weights", lambda *_: given)
    with pytest.raises(InputError, match="the person detector of BlazePose GHUM heavy is no network of TensorFlow Li"):
        run(clips, tmp_path / "dance", height=1.8, weights=tmp_path)
    assert done == []


def test_without_weights_and_network_nothing_is_begun_and_without_need_of_them_all_is(
    clips, done, real_weights, monkeypatch, tmp_path
):
    monkeypatch.setattr(_weights, "cache_folder", lambda name: tmp_path / "cache" / name)
    out, given = tmp_path / "dance", make_folder(tmp_path / "given")
    with pytest.raises(InputError, match=r"the weights of BlazePose GHUM heavy .* could not be downloaded"):
        run(clips, out, height=1.8)
    assert (done, out.exists()) == ([], False)
    for name in ("left", "right_hand"):
        (given / f"{name}.json").write_text(VIDEO)
    assert again(clips, out, keypoints=given)[1] == STAGES
    assert again(clips, out, keypoints=given)[1] == []
    with pytest.raises(InputError, match="could not be downloaded"):
        run(clips, tmp_path / "other", height=1.8, keypoints=given, scan=make_video(tmp_path / "walk.mp4"))
    (tmp_path / "views").mkdir()
    (tmp_path / "views" / "views.json").write_text("{}")  # with masks, so that nobody is looked for
    assert again(clips, tmp_path / "third", keypoints=given, scan=tmp_path / "views")[1][-1] == STAGES[-1]


def test_folders_of_others_and_of_other_videos_are_left_alone(clips, done, tmp_path):
    file = tmp_path / "file"
    file.write_text("mine")
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.txt").write_text("mine")
    with pytest.raises(InputError, match="is a file; a folder"):
        run(clips, file, height=1.8)
    with pytest.raises(InputError, match="holds files that no run wrote"):
        run(clips, foreign, height=1.8)
    assert [path.name for path in foreign.iterdir()] == ["thesis.txt"]
    out = tmp_path / "dance"
    out.mkdir()
    (out / ".DS_Store").write_text("a file manager's")
    again(clips, out)
    with pytest.raises(InputError, match="holds a run of other videos"):
        run(clips[:1], out, height=1.8)
    with pytest.raises(InputError, match=r"the same videos in another order; .* left, right_hand"):
        run(clips[::-1], out, height=1.8)
    assert (out / "result" / "motion.npz").is_file()
