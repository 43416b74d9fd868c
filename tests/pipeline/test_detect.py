"""Keypoints of drawn people in the videos of a capture, and cameras that tell which points are wrong."""

import json
import shutil
import sys
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import av
import jax.numpy as jnp
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "detection"))
from marked_person import MODEL, SIZE, answer, draw
from small_captures import look_at_pose

from jaxmocap._cli import run
from jaxmocap._results import InputError
from jaxmocap.camera import Cameras
from jaxmocap.capture import Capture, check
from jaxmocap.detection import FollowedPerson, Weights
from jaxmocap.pipeline import _detect, _follow_video, detect
from jaxmocap.pipeline._view_agreement import agreeing, refuse_views_of_different_people

COUNT = 8
TOML = """# two phones
name = "marked"
keypoint_layout = "body25"   # of nothing

[[camera]]
name = "left"
video = "left.mp4"

[[camera]]
name = "right"
video = "right.mp4"
"""


def place(name: str, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Hips and head in a picture."""
    x = {"left": 100.0, "right": 180.0}[name] + 4 * frame
    return np.array([x, 130.0]), np.array([x + 3 * frame, 85.0])


def film(file: Path, pictures) -> None:
    with av.open(str(file), "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"crf": "8"})
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        for number, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = number, Fraction(1, 30)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


@pytest.fixture(scope="module")
def filmed(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("filmed")
    for name in ("left", "right"):
        film(folder / f"{name}.mp4", [draw(place(name, frame), radius=5) for frame in range(COUNT)])
    film(folder / "empty.mp4", [draw()] * COUNT)
    return folder


@pytest.fixture
def marked(filmed, tmp_path) -> Path:
    """A capture without cameras and keypoints."""
    folder = tmp_path / "marked"
    folder.mkdir()
    for file in filmed.iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    (folder / "capture.toml").write_text(TOML)
    return folder


@pytest.fixture(autouse=True)
def followed(monkeypatch) -> list[tuple[int, ...]]:
    """The model that reads marks, and the frames it has been shown."""
    shown = []
    follow = _follow_video.follow_person

    def recorded(pictures, model, **options):
        shown.append(tuple(options["frames"]))
        return follow(pictures, model, **options)

    monkeypatch.setattr(_detect, "require_runner", lambda: None)
    monkeypatch.setattr(_follow_video, "get_weights", lambda *_: Weights("heavy", {"person": b"1", "landmarks": b"2"}))
    monkeypatch.setattr(_follow_video, "open_model", lambda weights: MODEL)
    monkeypatch.setattr(_follow_video, "follow_person", recorded)
    return shown


def test_keypoints_are_written_where_everything_looks_for_them(marked, followed):
    found = detect(marked)
    assert found.folder == marked / "keypoints"
    text = (marked / "capture.toml").read_text()
    assert text == TOML.replace('keypoint_layout = "body25"   # of nothing', 'keypoints = "keypoints"')
    capture = Capture.open(marked)
    for camera, name in enumerate(capture.camera_names):
        for frame in range(COUNT):
            expected = answer(*place(name, frame))
            np.testing.assert_allclose(found.people[name].points[frame, :, :2], expected, atol=1.0)
            points = capture.keypoints(camera, frame)
            np.testing.assert_allclose(points[5, :2], expected[11], atol=1.0)  # the left shoulder
            seen = capture.silhouette(camera, frame)
            assert seen is not None
            assert np.abs(np.argwhere(seen).mean(0)[::-1] + 0.5 - place(name, frame)[0]).max() < 1  # a disc at the hips
    assert not [finding for finding in check(marked) if finding.message.startswith("keypoints")]
    assert found.record["cameras"]["left"]["found"] == COUNT
    detect(marked)
    assert followed == [tuple(range(COUNT))] * 2  # not again


def test_frames_are_added_and_another_person_or_replace_begins_anew(marked, followed):
    detect(marked, frames=(0, 3), cameras=["right"])
    assert not (marked / "keypoints" / "left.json").exists()
    found = detect(marked, frames=(2, 5), cameras=["right"])
    assert found.people["right"].frames.tolist() == [0, 1, 2, 3, 4]
    silhouettes = marked / "keypoints" / "silhouettes"
    (silhouettes / "right_2_00000.png").write_bytes((silhouettes / "right_00000.png").read_bytes())
    found = detect(marked, frames=(6, 8), cameras=["right"], person={"right": (210, 130)})
    assert found.people["right"].frames.tolist() == [6, 7]
    kept = sorted(file.name for file in silhouettes.iterdir())
    assert kept == ["right_00006.png", "right_00007.png", "right_2_00000.png"]  # not those of who was followed before
    found = detect(marked, frames=(0, 2), cameras=["right"], person={"right": (210, 130)}, replace=True)
    assert found.people["right"].frames.tolist() == [0, 1]
    assert followed == [(0, 1, 2), (2, 3, 4), (6, 7), (0, 1)]


def test_it_is_said_in_which_picture_of_a_video_the_person_is_pointed_at(marked, capsys):
    (marked / "capture.toml").write_text(TOML.replace('"left.mp4"', '"left.mp4"\noffset = -0.1'))
    assert run(["detect", str(marked), "--person", "left=112,130"]) == 0  # where the person is when right.mp4 begins
    err = " ".join(capsys.readouterr().err.split())
    assert "left: the person is looked for at (112, 130) in frame 3 of left.mp4." in err
    assert "right: the person is looked for" not in err


def test_an_interrupted_run_goes_on_with_the_camera_it_was_at(marked, followed):
    def interrupt(stage, done, total):
        if stage == "detect right" and done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        detect(marked, progress=interrupt)
    assert (marked / "capture.toml").read_text() == TOML
    found = detect(marked)
    assert len(followed) == 3
    assert {name: len(person.frames) for name, person in found.people.items()} == {"left": COUNT, "right": COUNT}
    assert found.folder == marked / "keypoints"


def test_a_camera_that_was_cut_off_goes_on_to_the_same_bytes(marked, followed, monkeypatch, tmp_path):
    """Somebody is lost in two pictures before it is cut off, and the person is found anew after it."""
    pictures = [draw(place("left", frame), radius=5) for frame in range(30)]
    pictures[7] = pictures[8] = draw()
    film(marked / "left.mp4", pictures)
    film(marked / "right.mp4", [draw(place("right", frame), place("left", frame), radius=5) for frame in range(30)])
    whole = Path(shutil.copytree(marked, tmp_path / "whole"))
    detect(whole)
    monkeypatch.setattr(_follow_video, "_EVERY", 0.0)
    read, reading = [], _follow_video.FrameReader.read
    monkeypatch.setattr(
        _follow_video.FrameReader, "read", lambda reader, frame: (read.append(frame), reading(reader, frame))[1]
    )
    for name, count in (("left", 9), ("left", 20), ("right", 4)):

        def cut_off(stage, done, total, at=(f"detect {name}", count)):
            if (stage, done) == at:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            detect(marked, progress=cut_off)
        assert (marked / "capture.toml").read_text() == TOML
    said: list[str] = []
    detect(marked, say=said.append)
    assert read.count(5) == 2  # once in each video
    assert len(read) < 60 + 6
    assert "right: 3 of 30 pictures were looked at before; it goes on from there." in said

    def files(folder: Path) -> dict[str, bytes]:
        made = [folder / "detection.json", folder / "capture.toml", *(folder / "keypoints").rglob("*")]
        return {str(file.relative_to(folder)): file.read_bytes() for file in made if file.is_file()}

    assert files(marked) == files(whole)


def test_what_was_seen_of_somebody_else_or_is_damaged_is_not_gone_on_with(marked, followed, monkeypatch):
    monkeypatch.setattr(_follow_video, "_EVERY", 0.0)

    def cut_off(stage, done, total):
        if done == 5:
            raise KeyboardInterrupt

    for options in ({}, {"person": {"left": (100.0, 130.0)}}):
        with pytest.raises(KeyboardInterrupt):
            detect(marked, progress=cut_off, **options)
    said: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        detect(marked, progress=cut_off, say=said.append)
    (file,) = (marked / "keypoints").glob(".*.npz")
    file.write_bytes(file.read_bytes()[:300])
    detect(marked, say=said.append)
    assert not any("before" in sentence for sentence in said)


def test_keypoints_of_other_making_are_left_alone(marked, capsys):
    (marked / "keypoints").mkdir()
    theirs = TOML.replace("[[camera]]", 'keypoints = "keypoints"\n\n[[camera]]', 1)
    (marked / "capture.toml").write_text(theirs)
    assert run(["detect", str(marked)]) == 2
    err = capsys.readouterr().err
    assert "capture.toml names keypoints already ('keypoints'); remove the line, or use --replace" in err
    assert (marked / "capture.toml").read_text() == theirs
    assert detect(marked, replace=True).folder == marked / "keypoints-2"
    assert 'keypoints = "keypoints-2"' in (marked / "capture.toml").read_text()
    assert list((marked / "keypoints").iterdir()) == []


def test_an_open_capture_is_left_as_it_is(marked):
    found = detect(Capture.open(marked), cameras=["left"])
    assert found.folder is None
    assert list(found.people) == ["left"]
    assert {file.name for file in marked.iterdir()} == {"capture.toml", "left.mp4", "right.mp4", "empty.mp4"}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["--person", "middle=10,20"],
            "person names 'middle', which is no camera of capture 'marked'; it has left, right",
        ),
        (["--person", "left=10"], "--person has 'left=10'; CAMERA=X,Y was expected, such as cam0=430,250."),
        (["--person", "left=400,20"], "person is at (400, 20) of left, outside its pictures of 320 x 240 pixels"),
        (["--cameras", "up"], "cameras names 'up', which is no camera of capture 'marked'; it has left, right"),
        (["--frames", "5:90"], "--frames is '5:90', but the capture has 8 frames"),
    ],
)
def test_what_is_not_there_is_refused_in_a_sentence(arguments, words, marked, capsys):
    assert run(["detect", str(marked), *arguments]) == 2
    *_, sentence = capsys.readouterr().err.splitlines()
    assert words in sentence
    assert not (marked / "keypoints").exists()


def test_a_video_without_a_person_is_refused_and_the_others_are_kept(marked, capsys, followed):
    toml = TOML.replace('video = "right.mp4"', 'video = "empty.mp4"')
    (marked / "capture.toml").write_text(toml)
    assert run(["detect", str(marked)]) == 2
    *_, sentence = capsys.readouterr().err.splitlines()
    assert "nobody was found in the 8 pictures of camera right (empty.mp4); choose --frames in which" in sentence
    assert (marked / "capture.toml").read_text() == toml
    assert run(["detect", str(marked), "--cameras", "left", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["cameras"]["left"]["found"] == COUNT
    assert len(followed) == 2


def test_a_video_without_a_person_may_be_passed_over(marked, followed):
    (marked / "capture.toml").write_text(TOML.replace('video = "right.mp4"', 'video = "empty.mp4"'))
    with pytest.raises(InputError, match=r"nobody was found in any video \(right\); the person"):
        detect(marked, cameras=["right"], skip_empty=True)
    heard = []
    for capture in (marked, Capture.open(marked, with_cameras=False)):
        assert list(detect(capture, skip_empty=True, say=heard.append).people) == ["left"]
    assert not any("right" in sentence for sentence in heard)
    assert Capture.open(marked, with_cameras=False).keypoints(1, 0) is None


# Views held against each other ------------------------------------------------------------------------------------

NAMES = ("cam0", "cam1", "cam2")


@pytest.fixture
def views():
    """Three cameras around a moving cloud of 33 points: the capture, and what its views show, with half a pixel of
    noise."""
    random = np.random.default_rng(2)
    frames = 10
    world = random.uniform(-0.6, 0.6, (33, 3)) + [0, 1, 0] + np.linspace(0, 0.4, frames)[:, None, None]
    matrix = np.array([[700.0, 0, 320], [0, 700.0, 240], [0, 0, 1]])
    poses = np.stack([look_at_pose(angle) for angle in (-25.0, 5.0, 35.0)])
    cameras = Cameras(
        NAMES,
        ((640, 480),) * 3,
        jnp.asarray(np.tile(matrix, (3, 1, 1))),
        jnp.zeros((3, 5)),
        jnp.asarray(np.repeat(poses[:, None], frames, axis=1)),
    )
    own = np.stack([np.arange(frames), np.arange(frames) + 4, np.arange(frames)])
    people = {}
    for name, pose, numbers in zip(NAMES, poses, own, strict=True):
        pixels = (world @ pose[:3, :3].T + pose[:3, 3]) @ matrix.T
        points = np.concatenate([pixels[..., :2] / pixels[..., 2:], np.full((frames, 33, 1), 0.9)], axis=-1)
        points[..., :2] += 0.5 * random.normal(size=(frames, 33, 2))
        people[name] = FollowedPerson(numbers, points, points[..., 2].copy(), np.full(frames, 300.0), ())
    return SimpleNamespace(camera_names=NAMES, num_frames=frames, video_frames=own, cameras=cameras), people


def lowered(people, agreed):
    return {
        name: np.argwhere((agreed[name].points[..., 2] == 0) & (people[name].points[..., 2] > 0)).tolist()
        for name in people
    }


def test_of_three_views_the_one_that_none_agrees_with_is_not_believed(views):
    capture, people = views
    people["cam1"].points[3, 8, 1] += 60
    agreed, share = agreeing(capture, people)
    assert lowered(people, agreed) == {"cam0": [], "cam1": [[3, 8]], "cam2": []}
    assert share == 0


def test_another_person_is_not_believed_at_all(views):
    """Some points lie near the lines of the right person by chance."""
    capture, people = views
    people["cam1"].points[4, :, 1] += 55
    people["cam1"].points[4, 25, 1] -= 55  # a knee
    agreed, _ = agreeing(capture, people)
    assert lowered(people, agreed) == {"cam0": [], "cam1": [[4, point] for point in range(33)], "cam2": []}


def test_two_views_that_disagree_are_both_not_believed_and_one_alone_is(views):
    capture, people = views
    del people["cam2"]
    people["cam1"].points[3, 8, 1] += 60
    people["cam0"].points[5, 2, 2] = 0.0
    people["cam1"].points[5, 2, 1] += 60
    assert lowered(people, agreeing(capture, people)[0]) == {"cam0": [[3, 8]], "cam1": [[3, 8]]}


def test_where_much_disagrees_cameras_are_to_blame_and_nothing_is_changed(views):
    capture, people = views
    del people["cam2"]
    people["cam1"].points[::2, :, 1] += 70
    agreed, share = agreeing(capture, people)
    assert agreed is people
    assert share > 0.4


def test_cameras_that_the_person_contradicts_are_refused_and_others_are_not(views):
    """The detector's own noise is half a pixel; the third view follows somebody else."""
    seen, people = views

    def points(view, frame):
        own = int(seen.video_frames[view][frame]) - int(seen.video_frames[view][0])
        return [people[NAMES[view]].points[own, :25]]

    capture = SimpleNamespace(
        camera_names=NAMES,
        num_cameras=3,
        num_frames=seen.num_frames,
        sizes=((960, 540),) * 3,
        cameras=seen.cameras,
        keypoint_frames=lambda view: range(seen.num_frames),
        people=points,
    )
    refuse_views_of_different_people(capture)
    people["cam2"].points[..., 1] += 60
    with pytest.raises(InputError, match=r"'cam[01]' and 'cam2' lie \d\d pixels .* \(--person\)"):
        refuse_views_of_different_people(capture)
    people["cam2"].points[: seen.num_frames // 3, :, 1] -= 60
    refuse_views_of_different_people(capture, (0, seen.num_frames // 3))
