"""Files as programs write them, read through a capture; the answer is the person of `small` projected."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_captures import MATRIX, PERSON, POSES, SIZE, write_keypoints

from jaxmocap._results import InputError
from jaxmocap.capture import Capture, Detections, check, choose_frames, content_hash, path_hash
from jaxmocap.detection import BODY_25, LAYOUTS, read_people

FRAMES = (0, 6)


def moved(camera: str, frame: int) -> np.ndarray:
    """The 25 points in a camera's picture; the person goes up a little with every frame."""
    pose = POSES[camera]
    pixels = ((PERSON + [0, 0.01 * frame, 0]) @ pose[:3, :3].T + pose[:3, 3]) @ MATRIX.T
    return np.column_stack([pixels[:, :2] / pixels[:, 2:], np.full(25, 0.9)])


def of_layout(camera: str, frame: int, layout: str) -> np.ndarray:
    """The same person in another layout; points that BODY_25 has not lie in a corner."""
    known = dict(zip(BODY_25.points, moved(camera, frame), strict=True))
    return np.stack([known.get(name, np.array([1.0, 1.0, 0.2])) for name in LAYOUTS[layout].points])


def openpose(points: np.ndarray, **more: object) -> dict:
    """A person of OpenPose, and of Pose2Sim, which writes it with all keys."""
    return {"person_id": [-1], "pose_keypoints_2d": points.ravel().tolist(), "face_keypoints_2d": [], **more}


def mmpose(points: np.ndarray) -> dict:
    return {"keypoints": points[:, :2].tolist(), "keypoint_scores": points[:, 2].tolist(), "bbox": [[0, 0, 9, 9]]}


def alphapose(points: np.ndarray, frame: int) -> dict:
    return {"image_id": f"{frame}.jpg", "category_id": 1, "keypoints": points.ravel().tolist(), "score": 2.9}


def alphaposes(found: dict[int, np.ndarray]) -> list[dict]:
    return [alphapose(points, frame) for frame, points in found.items()]


def mediapipe(points: np.ndarray) -> list[dict]:
    shares = points[:, :2] / SIZE
    rows = zip(shares, points[:, 2], strict=True)
    return [{"x": x, "y": y, "z": 0.1, "visibility": c, "presence": c} for (x, y), c in rows]


def mediapipes(points: np.ndarray) -> dict:
    return {"pose_landmarks": [mediapipe(points)]}


def write(path: Path, document: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document))


def by_picture(name: str, layout: str, person_of) -> object:
    """Writes a file per picture; `name` has {video} and {frame}."""

    def into(folder: Path) -> None:
        for camera in POSES:
            for frame in FRAMES:
                file = folder / name.format(video=f"film_{camera}", camera=camera, frame=frame)
                write(file, person_of(of_layout(camera, frame, layout)))

    return into


def by_video(name: str, layout: str, document_of) -> object:
    def into(folder: Path) -> None:
        for camera in POSES:
            people = {frame: of_layout(camera, frame, layout) for frame in FRAMES}
            write(folder / name.format(video=f"film_{camera}", camera=camera), document_of(people))

    return into


def people(points: np.ndarray) -> dict:
    return {"version": 1.3, "people": [openpose(points)]}


OURS, POSE2SIM = "{camera}_{frame:05d}_keypoints.json", "{video}_json/{video}_{frame:06d}.json"
PROGRAMS = {
    "OpenPose": ("body25", by_picture("{video}_{frame:012d}_keypoints.json", "body25", people)),
    "OpenPose, a folder each": ("body25", by_picture("{camera}/{video}_{frame:012d}_keypoints.json", "body25", people)),
    "Pose2Sim": ("halpe26", by_picture(POSE2SIM, "halpe26", people)),
    "Pose2Sim, body": ("coco17", by_picture(POSE2SIM, "coco17", people)),
    "Pose2Sim, whole body": ("coco133", by_picture("{camera}/{video}_{frame:06d}.json", "coco133", people)),
    "Pose2Sim, BlazePose": ("blazepose33", by_picture(POSE2SIM, "blazepose33", people)),
    "rtmlib": ("halpe26", by_picture(OURS, "halpe26", people)),
    "MMPose, pictures": ("coco17", by_picture("{camera}/{frame:06d}.json", "coco17", lambda points: [mmpose(points)])),
    "MMPose, short names": (
        "coco17",
        by_picture("{camera}/{frame:04d}.json", "coco17", lambda points: [mmpose(points)]),
    ),
    "MMPose, the folder it wrote": (
        "coco17",
        by_video(
            "predictions/{video}.json",
            "coco17",
            lambda found: [{"frame_id": frame, "instances": [mmpose(points)]} for frame, points in found.items()],
        ),
    ),
    "MMPose, video": (
        "coco133",
        by_video(
            "{video}.json",
            "coco133",
            lambda found: [{"frame_id": frame, "instances": [mmpose(points)]} for frame, points in found.items()],
        ),
    ),
    "MMPose, demo": (
        "coco17",
        by_video(
            "results_{video}.json",
            "coco17",
            lambda found: {
                "meta_info": {"dataset_name": "coco"},
                "instance_info": [
                    {"frame_id": frame + 1, "instances": [mmpose(points)]} for frame, points in found.items()
                ],
            },
        ),
    ),
    "AlphaPose": (
        "halpe136",
        by_video("{video}/alphapose-results.json", "halpe136", alphaposes),
    ),
    "AlphaPose, 26": (
        "halpe26",
        by_video("{camera}.json", "halpe26", alphaposes),
    ),
    "MediaPipe": (
        "blazepose33",
        by_picture(OURS, "blazepose33", mediapipes),
    ),
}


@pytest.fixture
def filmed(small: Path) -> Path:
    """The capture with videos that are not named like their cameras, and no keypoints yet."""
    text = (small / "capture.toml").read_text()
    for camera in POSES:
        (small / f"{camera}.mp4").rename(small / f"film_{camera}.mp4")
        text = text.replace(f'"{camera}.mp4"', f'"film_{camera}.mp4"')
    (small / "capture.toml").write_text(text)
    shutil.rmtree(small / "keypoints")
    (small / "keypoints").mkdir()
    return small


def said(capture: Path, *words: str) -> list[str]:
    return [finding.severity for finding in check(capture) if all(word in finding.message for word in words)]


def refusal(capture: Path, camera: int = 0, frame: int = 0) -> str:
    with pytest.raises(InputError) as caught:
        Capture.open(capture).keypoints(camera, frame)
    return str(caught.value)


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_program_s_files_are_read_as_the_projected_person(filmed: Path, program: str):
    layout, into = PROGRAMS[program]
    into(filmed / "keypoints")
    capture = Capture.open(filmed)
    shared = [name in LAYOUTS[layout].points for name in BODY_25.points]
    for index, camera in enumerate(POSES):
        assert capture.keypoint_frames(index) == FRAMES
        assert capture.keypoints(index, 3) is None
        for frame in FRAMES:
            found, true = capture.keypoints(index, frame), moved(camera, frame)
            np.testing.assert_allclose(found[shared], true[shared], atol=1e-6)
            for middle, parts in ((1, (2, 5)), (8, (9, 12))):
                if not shared[middle]:
                    np.testing.assert_allclose(found[middle, :2], true[list(parts), :2].mean(0), atol=1e-6)
    detections = Detections.open(replace(capture, keypoints_folder=None), filmed / "keypoints", [6])
    assert [detections.has(0, frame) for frame in (0, 3, 6)] == [False, False, True]
    np.testing.assert_array_equal(detections.people(1, 6)[0], capture.keypoints(1, 6))


@pytest.mark.parametrize("program", ["OpenPose, a folder each", "Pose2Sim", "AlphaPose"])
def test_check_and_the_choice_of_frames_take_them_as_they_take_our_own(filmed: Path, program: str):
    PROGRAMS[program][1](filmed / "keypoints")
    findings = [finding for finding in check(filmed) if finding.severity != "note"]
    assert not [finding for finding in findings if "keypoints" in finding.message], findings
    capture = Capture.open(filmed)
    assert "among 2 frames with good keypoints" in choose_frames(capture, capture.cameras).reason


@pytest.mark.parametrize("program", ["Pose2Sim", "AlphaPose"])
def test_a_changed_file_is_read_again_and_changes_both_hashes(filmed: Path, program: str):
    PROGRAMS[program][1](filmed / "keypoints")
    capture = Capture.open(filmed)
    before = capture.keypoints(0, 6), content_hash(capture), path_hash(filmed / "keypoints")
    before[0][:] = -1.0  # a caller's own copy
    assert (capture.keypoints(0, 6)[:, :2] > 0).all()
    files = (file for file in (filmed / "keypoints").rglob("*.json") if "film_cam0" in str(file))
    file = next(file for file in files if "000000" not in file.name)
    file.write_text(file.read_text().replace("0.9", "0.7"))
    assert capture.keypoints(0, 6)[0, 2] == 0.7
    assert content_hash(capture) != before[1]
    assert path_hash(filmed / "keypoints") != before[2]


def test_what_file_managers_leave_is_no_keypoints(filmed: Path):
    PROGRAMS["Pose2Sim"][1](filmed / "keypoints")
    capture = Capture.open(filmed)
    before = capture.keypoints(0, 6), content_hash(capture), path_hash(filmed / "keypoints")
    folder = next(file for file in (filmed / "keypoints").rglob("*film_cam0*000006*.json")).parent
    for name in (".DS_Store", "Thumbs.db", "desktop.ini", ".1f.partial.film.json", "._film_cam0_000006.json"):
        (folder / name).write_bytes(b"\0")
    np.testing.assert_array_equal(capture.keypoints(0, 6), before[0])
    assert (content_hash(capture), path_hash(filmed / "keypoints")) == before[1:]


def test_the_video_s_name_counts_only_where_it_is_one_camera_s(small: Path):
    """cam0's video is called cam1.mp4 and the other way round."""
    text = (small / "capture.toml").read_text()
    text = text.replace("cam0.mp4", "x").replace("cam1.mp4", "cam0.mp4").replace('"x"', '"cam1.mp4"')
    (small / "capture.toml").write_text(text)
    write_keypoints(small / "keypoints" / "cam1_00003_keypoints.json", POSES["cam1"])
    capture = Capture.open(small)
    assert capture.keypoint_frames(0) == (0, 6)
    assert capture.keypoint_frames(1) == (0, 3, 6)


def test_a_person_that_pose2sim_did_not_find_is_nobody(filmed: Path):
    nobody = {"people": [openpose(np.full((26, 3), np.nan))]}
    write(filmed / "keypoints" / "film_cam0_json" / "film_cam0_000000.json", nobody)
    assert Capture.open(filmed).keypoints(0, 0) is None
    assert said(filmed, "film_cam0_000000.json show nobody") == ["warning"]


def test_what_is_wrong_with_many_files_is_said_once(filmed: Path):
    nobody, two = {"people": []}, {"people": 2 * people(of_layout("cam0", 0, "body25"))["people"]}
    for frame in range(8):
        wrong = {"people": [{"pose_keypoints_2d": [1.0, 2.0]}]} if frame > 5 else nobody if frame > 2 else two
        write(filmed / "keypoints" / f"cam0_{frame:05d}_keypoints.json", wrong)
    assert [finding.where for finding in check(filmed) if finding.where.startswith("cam0 frame")] == [
        "cam0 frame 6",
        "cam0 frame 3",
        "cam0 frame 0",
    ]
    assert said(filmed, "cam0_00003_keypoints.json show nobody; the same of 2 more, at frame 4-5") == ["warning"]
    assert said(filmed, "show 2 people; the one of the largest") == ["warning"]
    assert said(filmed, "; the same of 1 more, at frame 7") == ["error"]


def test_confidences_beyond_one_are_one(filmed: Path):
    points = of_layout("cam0", 0, "coco17") * [1, 1, 5]
    write(filmed / "keypoints" / "cam0.json", [alphapose(points, 0)])
    assert Capture.open(filmed).keypoints(0, 0)[:, 2].max() == 1.0
    (filmed / "keypoints" / "cam0.json").unlink()
    write(filmed / "keypoints" / "cam0_00000_keypoints.json", people(points))
    assert Capture.open(filmed).keypoints(0, 0)[:, 2].max() == 1.0


def test_keypoint_layout_decides_where_the_number_of_points_says_nothing(filmed: Path):
    more = np.concatenate([of_layout("cam0", 0, "coco17"), np.ones((4, 3))])
    write(filmed / "keypoints" / "cam0_00000_keypoints.json", people(more))
    assert "a person has 63 numbers; expected the 75 of OpenPose BODY_25" in refusal(filmed)
    toml = filmed / "capture.toml"
    toml.write_text('keypoint_layout = "coco17"\n' + toml.read_text())
    np.testing.assert_allclose(Capture.open(filmed).keypoints(0, 0)[0], moved("cam0", 0)[0])
    write(filmed / "keypoints" / "cam0_00000_keypoints.json", people(of_layout("cam0", 0, "halpe26")))
    assert "78 numbers, which looks like Halpe (26 points); keypoint_layout = 'coco17'" in refusal(filmed)
    assert said(filmed, "keypoint_layout = 'coco17' in capture.toml expects the 51 of COCO") == ["error"]
    toml.write_text(toml.read_text().replace('"coco17"', '"coco18"'))
    with pytest.raises(InputError, match=r"keypoint_layout = 'coco18' cannot be used: input should be 'body25'"):
        Capture.open(filmed)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("cam0_00000_keypoints.json", "", "is empty; run the detector again"),
        ("cam0.json", " \n", "is empty; run the detector again"),
        ("cam0/x_000000.json", "{", "is not JSON"),
        ("cam0/x_000000.json", '{"keypoint_layout": "mpi", "people": []}', "expected one of body25"),
        ("cam0.json", '{"annotations": []}', "not an OpenPose file, nor one of MMPose, AlphaPose or MediaPipe"),
        ("cam0.json", '[{"image_id": "first.jpg", "keypoints": []}]', "nor one of MMPose"),
        ("cam0.json", '[{"image_id": "0.jpg", "keypoints": [1, 2]}]', "a person has 2 numbers"),
        ("cam0.json", json.dumps([mmpose(np.ones((17, 3)))]), "are of one picture, and the name is that of a whole"),
        ("cam0_00000_keypoints.json", json.dumps([alphapose(np.ones((17, 3)), 0)]), "are of a whole video"),
        ("cam0_00000_keypoints.json", json.dumps([mmpose(np.ones((18, 3)))]), "18 points, which looks like COCO (18"),
        ("cam0_00000_keypoints.json", '[{"keypoints": [[1, 2]], "keypoint_scores": [1, 1]}]', "nor one of MMPose"),
        ("cam0_00000_keypoints.json", '{"pose_landmarks": [[{"x": 0.5, "y": 0.5}]]}', "nor one of MMPose"),
        ("cam0_00000_keypoints.json", json.dumps({"pose_landmarks": [mediapipe(np.ones((21, 3)))]}), "21 points"),
    ],
)
def test_what_cannot_be_read_is_one_sentence_of_opening_and_of_check(filmed: Path, name: str, text: str, words: str):
    file = filmed / "keypoints" / name
    file.parent.mkdir(exist_ok=True)
    file.write_text(text)
    sentence = refusal(filmed)
    assert sentence.startswith(f"keypoints {file} ") or sentence.startswith(f"keypoints {file}:")
    assert words in sentence
    assert "error" in said(filmed, words)


@pytest.mark.parametrize(
    "form",
    [
        lambda landmarks: {"landmark": landmarks},
        lambda landmarks: {"pose_landmarks": landmarks},
        lambda landmarks: {"pose_landmarks": {"landmark": landmarks}},
        lambda landmarks: {"pose_landmarks": [{"landmark": landmarks}]},
        lambda landmarks: {"landmarks": [landmarks], "worldLandmarks": [landmarks]},
    ],
    ids=["one message", "without a list", "a message by name", "messages", "in a browser"],
)
def test_every_form_in_which_mediapipe_writes_a_person_is_read(tmp_path: Path, form):
    points = np.random.default_rng(0).uniform(0.1, 0.9, (33, 3))
    for name, document in (("usual", {"pose_landmarks": [mediapipe(points)]}), ("other", form(mediapipe(points)))):
        write(tmp_path / f"{name}.json", document)
    usual, other = (read_people(tmp_path / f"{name}.json", size=(640, 480)) for name in ("usual", "other"))
    np.testing.assert_array_equal(usual, other)
    write(tmp_path / "nobody.json", {"pose_landmarks": None})
    assert read_people(tmp_path / "nobody.json", size=(640, 480)) == []


def test_mediapipe_without_the_size_of_the_picture_is_refused(tmp_path: Path):
    write(tmp_path / "front.json", {"pose_landmarks": [mediapipe(np.ones((33, 3)))]})
    with pytest.raises(InputError, match=r"front\.json are MediaPipe's, shares of a picture whose size is not known"):
        read_people(tmp_path / "front.json")


def test_several_people_other_pictures_and_files_too_long_are_said_once(filmed: Path):
    two = [alphapose(of_layout("cam0", frame, "coco17") * [1, 1, c], frame) for frame in (0, 5, 40) for c in (1, 0.5)]
    write(filmed / "keypoints" / "cam0.json", two)
    large = {frame: of_layout("cam1", frame, "coco17") * [3, 3, 1] for frame in range(12)}
    write(filmed / "keypoints" / "cam1.json", [alphapose(points, frame) for frame, points in large.items()])
    write(filmed / "keypoints" / "cam7_json" / "cam7_000000.json", people(of_layout("cam0", 0, "coco17")))
    assert said(filmed, "cam0.json show several people at 3 frames, first at 0") == ["warning"]
    assert said(filmed, "cam0.json goes on to frame 40, beyond the end of film_cam0.mp4") == ["warning"]
    assert said(filmed, "keypoints of cam1 lie as far as", "outside the 64x48 pixels of film_cam1.mp4") == ["warning"]
    assert said(filmed, "keypoints of cam0 lie as far as") == []
    assert said(filmed, "cam7_json is ignored") == ["warning"]
    assert said(filmed, "missing at the selected frame 6 of cam0: no ", "cam0_00006_keypoints.json") == ["warning"]
    assert len(Capture.open(filmed).people(0, 0)) == 2
    assert Capture.open(filmed).keypoints(0, 0)[0, 2] == 0.9


def test_real_keypoints_in_another_layout_register_alike(data: Path, tmp_path: Path):
    """BODY_25 of a real detector, written as Pose2Sim's Halpe-26 and read back: the same points."""
    capture = Capture.open(data / "balance")
    for index, camera in enumerate(capture.camera_names):
        known = dict(zip(BODY_25.points, json_points(capture, index), strict=True))
        points = np.stack([known.get(name, np.zeros(3)) for name in LAYOUTS["halpe26"].points])
        stem = capture.videos[index].stem
        write(tmp_path / f"{stem}_json" / f"{stem}_000000.json", people(points))
        other = replace(capture, keypoints_folder=tmp_path)
        np.testing.assert_array_equal(other.keypoints(index, 0), capture.keypoints(index, 0), err_msg=camera)


def json_points(capture: Capture, index: int) -> np.ndarray:
    file = capture.keypoints_folder / f"{capture.camera_names[index]}_00000_keypoints.json"
    (person,) = json.loads(file.read_text())["people"]
    return np.array(person["pose_keypoints_2d"]).reshape(25, 3)
