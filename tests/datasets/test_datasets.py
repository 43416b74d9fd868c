"""Small files in the forms of HumanEva, TNT15, BioCV, MoVi and OpenCap, written here, become captures."""

import os
import pickle
import subprocess
import sys

import cv2
import ezc3d
import numpy as np
import pytest
from scipy.io import savemat

from jaxmocap._results import InputError
from jaxmocap.capture import Capture
from jaxmocap.datasets import DATASETS, import_dataset, read_calibration
from jaxmocap.datasets._read_files import read_c3d
from jaxmocap.viewers import open_video

SIZE = (64, 48)
TURNS = [cv2.Rodrigues(np.array([1.2 + 0.1 * k, 0.3 * k, 0.1]))[0] for k in range(4)]


def shade(frame: int) -> int:
    return 20 + 20 * frame


def write_cal(path, index: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    numbers = [
        70 + index, 71 + index, 31.5, 23.5, 0, -0.2, 0.05, 0.001, -0.001, 0,
        *TURNS[index].ravel(), 100 * index, 50, 4000,
    ]  # fmt: skip
    path.write_text("\n".join(f"{number:.10g}" for number in numbers) + "\n")


def write_movie(path, count: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with open_video(path.with_suffix(".mp4"), quality=4) as writer:
        for frame in range(count):
            writer.write(frame / 60, np.full((SIZE[1], SIZE[0], 3), shade(frame), np.uint8))
    path.with_suffix(".mp4").rename(path)


def write_pictures(folder, count: int) -> None:
    folder.mkdir(parents=True)
    for frame in range(count):
        cv2.imwrite(str(folder / f"image_{frame + 1}.png"), np.full((SIZE[1], SIZE[0], 3), shade(frame), np.uint8))


def write_c3d(path, rate: float, points: dict[str, np.ndarray]) -> None:
    """Points (frame, 3) in millimetres by name."""
    path.parent.mkdir(parents=True, exist_ok=True)
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [rate]
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    file["parameters"]["POINT"]["LABELS"]["value"] = list(points)
    values = np.ones((4, len(points), len(next(iter(points.values())))))
    values[:3] = np.stack(list(points.values())).transpose(2, 0, 1)
    file["data"]["points"] = values
    file.write(str(path))


def write_markers(path, count: int) -> None:
    """Marker 0 moves 1 mm along x per mocap frame, marker 1 is not seen in the first ones."""
    first = np.stack([np.arange(count), np.full(count, 500.0), np.full(count, 900.0)], axis=1)
    second = np.full((count, 3), 700.0)
    second[:12] = 0.0
    write_c3d(path, 120.0, {"LFWT": first, "RFWT": second})


@pytest.fixture
def humaneva(tmp_path):
    """Image 3 of C1 shows mocap frame 7: its first image was taken at mocap frame 3."""
    base = tmp_path / "data" / "S1"
    for index, (camera, image) in enumerate((("C1", 3), ("C2", 3), ("C3", 4))):
        write_cal(base / "Calibration_Data" / f"{camera}.cal", index)
        write_movie(base / "Image_Data" / f"Walking_1_({camera}).avi", 6)
        (base / "Sync_Data").mkdir(exist_ok=True)
        (base / "Sync_Data" / f"Walking_1_({camera}).ofs").write_text(f"{image}\n7\n2\n")
    write_markers(base / "Mocap_Data" / "Walking_1.c3d", 40)
    return tmp_path / "data"


def test_a_take_of_humaneva_becomes_a_capture(humaneva, tmp_path):
    capture = Capture.open(import_dataset("humaneva-1", humaneva, tmp_path / "walk"))
    assert capture.camera_names == ("C1", "C2", "C3")
    assert capture.up == "z"
    cameras = capture.cameras
    np.testing.assert_allclose(np.asarray(cameras.cam_from_world)[:, 0, :3, :3], TURNS[:3], atol=1e-6)
    np.testing.assert_allclose(np.asarray(cameras.cam_from_world)[:, 0, :3, 3], [[0.1 * k, 0.05, 4] for k in range(3)])
    np.testing.assert_allclose(np.asarray(cameras.intrinsics)[1], [[71, 0, 32], [0, 72, 24], [0, 0, 1]], atol=1e-5)
    np.testing.assert_allclose(np.asarray(cameras.distortion)[0], [-0.2, 0.05, 0.001, -0.001, 0], atol=1e-7)
    # C3 shows the same instant one image later, so it began one image earlier
    np.testing.assert_allclose(capture.offsets, [0, 0, -1 / 60], atol=1e-6)
    assert capture.video_frames[2, 0] == capture.video_frames[0, 0] + 1
    with np.load(capture.truth) as truth:
        markers, times = truth["markers"], truth["timestamps"]
    at_first = np.interp(0.0, times, markers[:, 0, 0])
    assert at_first == pytest.approx(0.002)  # the third mocap frame
    np.testing.assert_allclose(np.interp(2 / 60, times, markers[:, 0, 0]), 0.006)  # image 3: the seventh
    assert np.isnan(markers[0, 1]).all()
    np.testing.assert_allclose(markers[-1, 1], 0.7)


def test_a_part_of_a_take_keeps_its_time(humaneva, tmp_path):
    capture = Capture.open(import_dataset("humaneva-1", humaneva, tmp_path / "part", frames=(2, 5)))
    assert capture.indices[0].num_frames == 3
    assert abs(int(capture.image(0, 0).mean()) - shade(2)) < 4
    with np.load(capture.truth) as truth:
        assert np.interp(0.0, truth["timestamps"], truth["markers"][:, 0, 0]) == pytest.approx(0.006)


def test_humaneva_2_reads_folders_of_pictures_and_takes_three_cameras(tmp_path):
    base = tmp_path / "data" / "S4"
    for index in range(4):
        camera = f"C{index + 1}"
        write_cal(base / "Calibration_Data" / f"{camera}.cal", index)
        write_pictures(base / "Image_Data" / f"Combo_1_({camera})", 11)
        (base / "Sync_Data").mkdir(exist_ok=True)
        (base / "Sync_Data" / f"Combo_1_({camera}).ofs").write_text("1 1 2")
    capture = Capture.open(import_dataset("humaneva-2", tmp_path / "data", tmp_path / "combo"))
    assert capture.camera_names == ("C1", "C2", "C3")
    assert capture.num_frames == 11
    assert capture.truth is None
    assert [abs(int(capture.image(1, frame).mean()) - shade(frame)) < 4 for frame in (0, 1, 9, 10)] == [True] * 4
    four = import_dataset("humaneva-2", tmp_path / "data", tmp_path / "four", cameras=("C1", "C2", "C3", "C4"))
    assert Capture.open(four).num_cameras == 4


def test_tnt15_takes_the_cameras_of_the_paper(tmp_path):
    base = tmp_path / "data" / 'My "best" take'
    for camera in range(6):
        write_pictures(base / "Images" / str(camera), 3)
        (base / "Calibration").mkdir(exist_ok=True)
        turn = TURNS[camera % 4]
        pose = np.column_stack([turn, [0, 100.0, 3000.0]])
        numbers = [*np.array([[60, 0, 32], [0, 60, 24], [0, 0, 1.0]]).ravel(), *pose.ravel()]
        (base / "Calibration" / f"{camera}.txt").write_text(" ".join(f"{number:.9g}" for number in numbers))
    capture = Capture.open(import_dataset("tnt15", tmp_path / "data", tmp_path / "out"))
    assert capture.name == 'TNT15-My "best" take'
    assert capture.camera_names == ("cam0", "cam2", "cam4")
    assert capture.fps == pytest.approx(50)
    np.testing.assert_allclose(np.asarray(capture.cameras.cam_from_world)[1, 0, :3, 3], [0, 0.1, 3], atol=1e-6)
    with pytest.raises(InputError, match=r"--frames begins at 3, but .*Images.0 has 3 frames\.$"):
        import_dataset("tnt15", tmp_path / "data", tmp_path / "none", frames=(3, 5))


def write_biocv(base, cameras: int) -> None:
    """A trial of 6 frames at 60 per second, calibrated in two worlds: the aligned one is that of the markers."""
    trial = base / "P03_WALK_01"
    for number in range(cameras):
        write_movie(trial / f"{number:02d}.mp4", 6)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = TURNS[number], [100 * number, 50, 4000]
        lens = np.array([[70, 0, 31.5], [0, 71 + number, 23.5], [0, 0, 1.0]])
        for name, shift in ((".calib", 1e6), ("-mocAligned2.calib", 0.0)):
            moved = pose.copy()
            moved[0, 3] += shift
            moved[:3] *= 1.0 if shift else 0.998  # brought into the markers' world by a similarity
            numbers = [*SIZE, *lens.ravel(), *moved.ravel(), -0.2, 0.05, 0.001, -0.001, 0.3]
            path = base / "calib_00" / f"{number:02d}.mp4{name}"
            path.parent.mkdir(exist_ok=True)
            path.write_text("\n".join(f"{number:.10g}" for number in numbers) + "\n")
    path = np.stack([np.arange(6.0), np.full(6, 300.0), np.full(6, 900.0)], axis=1)
    hidden = path + 50
    hidden[:2] = 0
    write_c3d(trial / "markers.c3d", 60.0, {"LASI": path, "LEFT_KNEE": path + 10, "V_Pelvis": path, "RASI": hidden})
    write_c3d(trial / "raw.c3d", 60.0, {"LASI": path, "RASI": hidden, "*1": path})


def test_a_trial_of_biocv_has_joint_centres_and_the_markers_of_its_unprocessed_file(tmp_path):
    write_biocv(tmp_path / "data" / "P03", 3)
    capture = Capture.open(import_dataset("biocv", tmp_path / "data", tmp_path / "walk"))
    assert capture.camera_names == ("cam00", "cam01", "cam02")
    assert (capture.up, capture.num_frames) == ("z", 6)
    cameras = capture.cameras
    poses = np.asarray(cameras.cam_from_world)[:, 0]
    np.testing.assert_allclose(poses[:, :3, :3], TURNS[:3], atol=1e-6)
    np.testing.assert_allclose(poses[:, :3, 3], [[0.1 * k, 0.05, 4] for k in range(3)], atol=1e-6)
    np.testing.assert_allclose(np.asarray(cameras.intrinsics)[1], [[70, 0, 32], [0, 72, 24], [0, 0, 1]], atol=1e-5)
    np.testing.assert_allclose(np.asarray(cameras.distortion)[2], [-0.2, 0.05, 0.001, -0.001, 0.3], atol=1e-7)
    with np.load(capture.truth) as truth:
        assert truth["joint_names"].tolist() == ["l_knee"]
        np.testing.assert_allclose(truth["joints"][:, 0, 0], 1e-3 * (np.arange(6) + 10), atol=1e-7)
        assert truth["markers"].shape == (6, 2, 3)  # not the virtual point, and no joint
        assert np.isnan(truth["markers"][:2, 1]).all()
        np.testing.assert_allclose(truth["timestamps"], np.arange(6) / 60, atol=1e-4)
    part = import_dataset("biocv", tmp_path / "data", tmp_path / "part", cameras=("00", "02"), frames=(2, 5))
    assert Capture.open(part).camera_names == ("cam00", "cam02")
    with np.load(part / "truth.npz") as truth:
        assert np.interp(0.0, truth["timestamps"], truth["joints"][:, 0, 0]) == pytest.approx(0.012, abs=1e-5)
    (tmp_path / "data" / "P03" / "P03_WALK_01" / "raw.c3d").unlink()
    bare = import_dataset("biocv", tmp_path / "data", tmp_path / "bare")
    with np.load(bare / "truth.npz") as truth:
        assert set(truth) == {"joints", "joint_names", "timestamps"}
    (tmp_path / "data" / "P03" / "calib_00" / "01.mp4-mocAligned2.calib").write_text("64 48 1 2 3")
    with pytest.raises(InputError, match="5 numbers; 32 were expected"):
        import_dataset("biocv", tmp_path / "data", tmp_path / "out")


def write_movi(base) -> None:
    """Two motions in eight frames at 30 per second; MATLAB's cameras, whose vectors are rows and which count from 1."""
    for number, camera in enumerate(("PG1", "PG2")):
        write_movie(base / "videos" / f"F_{camera}_Subject_7_L.avi", 8)
        lens = np.array([[70, 0, 32.5], [0, 71, 24.5], [0, 0, 1.0]])
        (base / "Calib").mkdir(exist_ok=True)
        np.savez(
            base / "Calib" / f"cameraParams_{camera}.npz",
            IntrinsicMatrix=lens.T, RadialDistortion=[[-0.2, 0.05]], TangentialDistortion=[[0.001, -0.002]],
        )  # fmt: skip
        translation = [[100.0 * number, 50, 4000]]
        np.savez(
            base / "Calib" / f"Extrinsics_{camera}.npz", rotationMatrix=TURNS[number].T, translationVector=translation
        )
    markers = np.zeros((32, 2, 3))
    markers[:, 0] = np.stack([np.arange(32), np.full(32, 300), np.full(32, 900)], axis=1)
    move = {
        "markerLocation": markers, "flags30": [[1, 3], [4, 7]], "flags120": [[1, 12], [13, 28]],
        "motions_list": np.array(["walking", "throw/catch"], object),
    }  # fmt: skip
    savemat(base / "F_v3d_Subject_7.mat", {"Subject_7_F": {"id": 7, "move": move}})


def test_a_motion_of_movi_is_its_part_of_the_video_and_of_the_markers(tmp_path):
    write_movi(tmp_path / "data")
    with pytest.raises(InputError, match="Subject_7/walking, Subject_7/throw/catch"):
        import_dataset("movi", tmp_path / "data", tmp_path / "out")
    made = import_dataset("movi", tmp_path / "data", tmp_path / "out", sequence="Subject_7/throw/catch")
    capture = Capture.open(made)
    assert capture.camera_names == ("PG1", "PG2")
    assert (capture.up, capture.num_frames) == ("z", 4)
    assert [abs(int(capture.image(1, k).mean()) - shade(3 + k)) < 4 for k in range(4)] == [True] * 4
    poses = np.asarray(capture.cameras.cam_from_world)[:, 0]
    np.testing.assert_allclose(poses[:, :3, :3], TURNS[:2], atol=1e-6)
    np.testing.assert_allclose(poses[:, :3, 3], [[0, 0.05, 4], [0.1, 0.05, 4]], atol=1e-6)
    np.testing.assert_allclose(
        np.asarray(capture.cameras.intrinsics)[0], [[70, 0, 32], [0, 71, 24], [0, 0, 1]], atol=1e-5
    )
    np.testing.assert_allclose(np.asarray(capture.cameras.distortion)[0], [-0.2, 0.05, 0.001, -0.002, 0], atol=1e-7)
    with np.load(capture.truth) as truth:
        assert truth["markers"].shape == (16, 2, 3)
        assert truth["markers"][0, 0, 0] == pytest.approx(0.012)
        assert np.isnan(truth["markers"][:, 1]).all()
        assert truth["timestamps"][4] == pytest.approx(1 / 30)
    part = import_dataset("movi", tmp_path / "data", tmp_path / "part", sequence="Subject_7/throw/catch", frames=(2, 9))
    assert Capture.open(part).num_frames == 2
    with np.load(part / "truth.npz") as truth:
        assert truth["markers"][0, 0, 0] == pytest.approx(0.020)
    with pytest.raises(InputError, match=r"begins at 4, but .*_L\.avi has 4 frames of MoVi-Subject_7-throw-catch"):
        import_dataset("movi", tmp_path / "data", tmp_path / "none", sequence="Subject_7/throw/catch", frames=(4, 9))
    (tmp_path / "data" / "F_PG1_Subject_8_L.avi").write_bytes(b"")  # whose recording has not been fetched
    import_dataset("movi", tmp_path / "data", tmp_path / "again", sequence="Subject_7/walking")
    savemat(tmp_path / "data" / "F_v3d_Subject_7.mat", {"Subject_7_F": {"move": {"flags30": [[1, 3]]}}})
    with pytest.raises(InputError, match="flags120, markerLocation, motions_list is not there"):
        import_dataset("movi", tmp_path / "data", tmp_path / "none")


OPENCAP = "cameraIntrinsicsExtrinsics.pickle"


def opencap_camera(number: int) -> dict:
    """A phone that stands upright before a checkerboard whose y points down, millimetres."""
    angle = 0.4 * (number - 2)
    around = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
    return {
        "distortion": np.array([[0.1, -0.2, 0.001, -0.002, 0.2134]]),
        "intrinsicMat": np.array([[70.0 + number, 0, 23.5], [0, 71.0, 31.5], [0, 0, 1]]),
        "imageSize": np.array([[64], [48]]),
        "rotation": around,
        "translation": np.array([[100.0 * number], [50.0], [4000.0]]),
        "rotation_EulerAngles": cv2.Rodrigues(around)[0],
    }


def write_opencap(base, below: str = "", protocol: int = 4) -> None:
    """A trial of five frames from three phones in portrait."""
    for number in (1, 2, 3):
        folder = base / "subject2" / "VideoData" / "Session0" / f"Cam{number}"
        path = folder / below / "DJ1" / "DJ1_syncdWithMocap.mp4"
        path.parent.mkdir(parents=True)
        with open_video(path, quality=4) as writer:
            for frame in range(5):
                writer.write(frame / 60, np.full((SIZE[0], SIZE[1], 3), shade(frame), np.uint8))
        path.rename(path.with_suffix(".avi"))
        (folder / OPENCAP).write_bytes(pickle.dumps(opencap_camera(number), protocol))


@pytest.mark.parametrize(("below", "protocol"), [("", 0), ("", 2), ("InputMedia", 4), ("", 5)])
def test_a_trial_of_opencap_has_its_cameras_in_a_world_with_y_up_and_no_truth(below, protocol, tmp_path):
    write_opencap(tmp_path / "data", below, protocol)
    said = []
    capture = Capture.open(import_dataset("opencap", tmp_path / "data", tmp_path / "out", say=said.append))
    assert "no truth" in said[0]
    assert capture.name == "OpenCap-subject2-Session0-DJ1"
    assert capture.camera_names == ("Cam1", "Cam2", "Cam3")
    assert (capture.up, capture.num_frames, capture.truth) == ("y", 5, None)
    assert capture.fps == pytest.approx(60, rel=1e-3)
    cameras = capture.cameras
    poses = np.asarray(cameras.cam_from_world)[:, 0]
    turns = [opencap_camera(number)["rotation"].T @ poses[number - 1, :3, :3] for number in (1, 2, 3)]
    np.testing.assert_allclose(turns, [turns[0]] * 3, atol=1e-6)
    np.testing.assert_allclose(turns[0][:, 1], [0, -1, 0], atol=1e-6)
    assert np.linalg.det(turns[0]) == pytest.approx(1)
    np.testing.assert_allclose(poses[:, :3, 3], [[0.1 * number, 0.05, 4] for number in (1, 2, 3)], atol=1e-6)
    np.testing.assert_allclose(np.asarray(cameras.intrinsics)[0], [[71, 0, 24], [0, 71, 32], [0, 0, 1]], atol=1e-5)
    np.testing.assert_allclose(np.asarray(cameras.distortion)[1], [0.1, -0.2, 0.001, -0.002, 0.2134], atol=1e-6)


class Evil:
    def __init__(self, *call):
        self.call = call

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"rotation": Evil(os.system, ("touch evil",))}, "asks for posix.system"),
        ({"rotation": Evil(eval, ("open('evil', 'w')",))}, "asks for builtins.eval"),
        ({"rotation": Evil(np.load, ("evil.npy", None, True))}, "asks for numpy.load"),
        ({"rotation": Evil(getattr, (np.eye(3), "tofile"))}, "asks for builtins.getattr"),
        ({"rotation": [print]}, "asks for builtins.print"),
        ({"rotation": np.array([{}], object)}, "type 'O8'"),
        (np.eye(3), "holds something else than a dictionary"),
        ({"rotation": 3}, "has nothing as intrinsicMat; 9 finite numbers were expected"),
        ({**opencap_camera(1), "distortion": np.zeros(4)}, r"an array of shape \(4,\) as distortion; 5 finite numbers"),
        ({**opencap_camera(1), "translation": np.full(3, np.nan)}, "as translation; 3 finite numbers"),
        ({**opencap_camera(1), "rotation": np.zeros((3, 3))}, "holds no camera"),
        ({**opencap_camera(1), "rotation": cv2.Rodrigues(np.array([0.8, 0, 0]))[0]}, "no axis of the checkerboard"),
        ({**opencap_camera(1), "intrinsicMat": np.diag([70.0, 70, 1])}, "lies on its side"),
        (b"", "is no pickle of arrays"),
        (b"cnumpy\nndarray\n(I1\ntR.", "holds something else"),
        (pickle.dumps(opencap_camera(1))[:-30], "is no pickle of arrays"),
        (b"\x80\x05\x96" + (2**36).to_bytes(8, "little") + b"...", "is no pickle of arrays"),  # 64 GB of nothing
        (
            b"cnumpy.core.numeric\n_frombuffer\n(I10000000000\ncnumpy\ndtype\n(S'f8'\ntR(I1\ntS'C'\ntR.",
            "an array of the data 10000000000",  # of which Python would make as many bytes
        ),
        (b"\x80\x02K\x01r\xff\xff\xff\x7f.", "holds something else"),  # remembered as the 2147483647th
        (bytes(2**20 + 1), "larger than a megabyte"),
    ],
)
def test_a_pickle_that_is_no_camera_is_refused_in_one_sentence_and_runs_nothing(content, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_opencap(tmp_path / "data")
    path = tmp_path / "data" / "subject2" / "VideoData" / "Session0" / "Cam1" / OPENCAP
    path.write_bytes(content if isinstance(content, bytes) else pickle.dumps(content))
    with pytest.raises(InputError, match=words) as caught:
        import_dataset("opencap", tmp_path / "data", tmp_path / "out", cameras=("Cam1",))
    assert "\n" not in str(caught.value)
    assert [one.name for one in tmp_path.iterdir()] == ["data"]


@pytest.mark.parametrize("dataset", sorted(DATASETS))
def test_an_empty_folder_says_what_to_get_and_its_licence(dataset, tmp_path):
    with pytest.raises(InputError, match=r"Get it from http.*Licence: (free for research|as its page says)"):
        import_dataset(dataset, tmp_path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("content", [b"", b"no c3d", bytes([2, 80]) + bytes(700)])
def test_a_damaged_c3d_file_is_one_sentence(content, tmp_path):
    (tmp_path / "take.c3d").write_bytes(content)
    with pytest.raises(InputError, match=r"take\.c3d is no C3D file that can be read"):
        read_c3d(tmp_path / "take.c3d")


def test_mistakes_are_one_sentence_and_leave_nothing(humaneva, tmp_path):
    def refused(text, **changes):
        arguments = {"dataset": "humaneva-1", "folder": humaneva, "out": tmp_path / "out"} | changes
        with pytest.raises(InputError, match=text):
            import_dataset(**arguments)
        assert not (tmp_path / "out").exists()

    refused("no reader for 'h36m'", dataset="h36m")
    refused("'S1/Jog_1' is not there", sequence="S1/Jog_1")
    refused("C9.*is not there", cameras=("C1", "C9"))
    refused(r"--frames begins at 100, but .*Walking_1_\(C1\)\.avi has 6 frames", frames=(100, 200))
    cal = humaneva / "S1" / "Calibration_Data" / "C2.cal"
    whole = cal.read_text()
    cal.write_text("\n".join(whole.splitlines()[:12]))
    refused("12 numbers; 22 were expected")
    cal.write_text(whole.replace("71", "-71"))
    refused("no camera")
    cal.write_text(whole + "x")
    refused("no number")


def test_distortion_and_rotation_survive_a_calibration_file(tmp_path):
    write_cal(tmp_path / "C1.cal", 2)
    found = read_calibration(tmp_path / "C1.cal")
    np.testing.assert_allclose(found.rotation, TURNS[2], atol=1e-8)
    np.testing.assert_allclose(found.translation, [0.2, 0.05, 4.0])


def test_the_command_makes_the_same_capture(humaneva, tmp_path):
    out = tmp_path / "walk"
    command = [sys.executable, "-m", "jaxmocap", "import-dataset", "humaneva-1", str(humaneva), "--out", str(out)]
    answer = subprocess.run([*command, "--json"], capture_output=True, text=True, check=True)
    assert '"cameras"' in answer.stdout
    assert (out / "capture.toml").is_file()
    assert subprocess.run(command, capture_output=True, check=False).returncode == 2
