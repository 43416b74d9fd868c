"""What `check` says of the cameras of a capture: angles and depth, the picture's edge, calibration, synchronisation."""

import json
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from small_captures import PERSON, POSES, look_at_pose, make_video, write_keypoints, write_mask, write_model

from jaxmocap._cli import run
from jaxmocap._results import InputError
from jaxmocap.camera import read_colmap_points
from jaxmocap.capture import Capture, Finding, check
from jaxmocap.pipeline._track_capture import _say_what_is_beyond

TALL = "2 PINHOLE 64 96 60 60 32 48"


def said(folder: Path, severity: str, *words: str) -> Finding:
    """The one finding of this severity that has all the words."""
    found = [f for f in check(folder) if f.severity == severity and all(word in f.message for word in words)]
    assert len(found) == 1, found
    return found[0]


def film_from(folder: Path, *angles: float, height: float = 0.0) -> None:
    """Cameras at these angles about the person, who floats `height` metres above the ground."""
    poses = {f"cam{number}": look_at_pose(angle) for number, angle in enumerate(angles)}
    write_model(folder / "cameras", poses, 12)
    for name, pose in poses.items():
        for frame in (0, 6):
            file = folder / "keypoints" / f"{name}_{frame:05d}_keypoints.json"
            write_keypoints(file, pose, points=PERSON + [0, height, 0])


def centimetres(finding: Finding) -> tuple[float, float]:
    """Across and in depth."""
    found = re.search(r"is ([\d.]+) cm across and ([\d.]+) cm in depth", finding.message)
    assert found is not None
    return float(found[1]), float(found[2])


def test_five_degrees_are_ten_times_worse_in_depth_than_fifty_and_warned_of(small: Path):
    film_from(small, -25, 25)
    across, wide = centimetres(said(small, "note", "cam0 and cam1", "directions 50 degrees apart"))
    assert across == pytest.approx(100 * 4 / 60 / np.sqrt(2), abs=0.1)  # 4 m, a focal length of 60 pixels
    assert wide == pytest.approx(across / np.sin(np.radians(25)), rel=0.03)
    film_from(small, -2.5, 2.5)
    narrow = said(small, "warning", "directions 5.0 degrees apart", "film again", "23 times")
    assert centimetres(narrow)[1] / wide == pytest.approx(9.7, abs=0.5)
    film_from(small, 0.0, 179.99)
    said(small, "warning", "depth", "apart")


def test_a_narrow_pair_of_three_cameras_is_no_reason_to_warn(small: Path):
    toml = small / "capture.toml"
    toml.write_text(toml.read_text() + '\n[[camera]]\nname = "cam2"\nvideo = "cam2.mp4"\n')
    (small / "cam2.mp4").write_bytes((small / "cam1.mp4").read_bytes())
    film_from(small, -20, -15, 20)
    said(small, "note", "cam0 and cam1", "directions 5.0 degrees apart")
    said(small, "note", "the outermost of all cameras see the person from directions 40 degrees apart")
    film_from(small, -4, 0, 4)
    said(small, "warning", "the outermost of all cameras", "directions 8.0 degrees apart")


def test_a_person_who_leaves_the_picture_and_one_far_away_are_named(small: Path):
    said(small, "note", "cam0 has 100% of the person's keypoints")
    film_from(small, -12, 12, height=1.5)
    assert said(small, "warning", "cam1 has", "at frame 0, 6 not all of them").where == "cam1"
    far = {name: look_at_pose(angle, 20.0) for name, angle in (("cam0", -12), ("cam1", 12))}
    write_model(small / "cameras", far, 12)
    for name, pose in far.items():
        for frame in (0, 6):
            write_keypoints(small / "keypoints" / f"{name}_{frame:05d}_keypoints.json", pose)
    said(small, "warning", "of cam0's picture tall", "film from nearer")


def test_a_person_larger_than_what_pictures_of_several_shapes_have_in_common_is_named(small: Path):
    """cam1 is twice as tall as cam0, and its person higher than cam0's whole picture."""
    near = {"cam0": look_at_pose(-12.0), "cam1": look_at_pose(12.0, 1.9)}
    make_video(small / "cam1.mp4", size=(64, 96))
    write_model(small / "cameras", near, 12)
    lines = (small / "cameras" / "cameras.txt").read_text()
    (small / "cameras" / "cameras.txt").write_text(lines.replace("2 PINHOLE 64 48 60 60 32 24", TALL))
    for file in (small / "masks").glob("cam1*"):
        write_mask(file, (64, 96))
    for frame in (0, 6):
        file = small / "keypoints" / f"cam1_{frame:05d}_keypoints.json"
        write_keypoints(file, near["cam1"])
        person = json.loads(file.read_text())
        points = np.array(person["people"][0]["pose_keypoints_2d"]).reshape(25, 3) + [0, 24, 0]
        file.write_text(json.dumps({"people": [{"pose_keypoints_2d": points.ravel().tolist()}]}))
    finding = said(small, "warning", "pixels of cam1's picture, but only 64x48 of each view are tracked")
    assert finding.where == "cam1"
    told: list[str] = []
    _say_what_is_beyond(Capture.open(small), told.append)
    (sentence,) = told
    assert sentence.startswith("The person takes about ")
    assert finding.message[1:] in sentence


def write_report(folder: Path, **changes: object) -> None:
    """What `calibrate` leaves beside a faultless model, with changes to the first camera's part."""
    camera = {
        "focal_pixels": 60.0,
        "interpolated": [],
        "median_residual_pixels": 0.05,
        "median_observations": 300,
        "centre_deviation_m": 0.001,
        "rotation_deviation_degrees": 0.05,
    }
    record = {
        "cameras": {"cam0": {**camera, **changes}, "cam1": camera},
        "scale": {"from": "actor", "relative_deviation": 0.01},
        "gravity": {"from": "ground"},
        "warnings": [],
    }
    (folder / "calibration.json").write_text(json.dumps(record))
    table = {"frame": list(range(12)), "centre_deviation": [0.001] * 12, "rotation_deviation": [0.05] * 12}
    (folder / "uncertainty.json").write_text(json.dumps({"cam0": table, "cam1": table}))


def test_the_report_of_a_calibration_is_told(small: Path):
    cameras = small / "cameras"
    write_report(cameras)
    assert not [f for f in check(small) if f.severity != "note"]
    said(small, "note", "cam0 was calibrated", "60.0 pixels", "0.10 cm", "0.050 degrees")
    said(small, "note", "the scale is from the actor, to 1.0 %", "ground")
    write_report(cameras, median_residual_pixels=0.5)
    said(small, "warning", "fits cam0's poses only to 0.50 pixels", "--key-step 2")
    write_report(cameras, interpolated=[3, 4, 6])
    assert said(small, "warning", "filled in", "of these 6 is selected").where == "cam0 frame 3-4, 6"
    write_report(cameras)
    table = json.loads((cameras / "uncertainty.json").read_text())
    table["cam1"]["rotation_deviation"][5] = 2.0  # degrees, 4 m away: 14 cm
    (cameras / "uncertainty.json").write_text(json.dumps(table))
    said(small, "warning", "cam1's pose is so uncertain at frame 5", "14 cm")
    (cameras / "calibration.json").write_text('{"cameras": 3}')
    said(small, "warning", "not what calibrate writes", "--replace")


def test_points_of_a_model_from_elsewhere_tell_how_well_it_fits(small: Path):
    cameras = small / "cameras"
    lines = [f"{number + 1} {number} 1 2 0 0 0 {error} 1 1" for number, error in enumerate((0.02, 0.04, 0.06))]
    (cameras / "points3D.txt").write_text("# points\n" + "\n".join(lines) + "\n")
    said(small, "note", "3 points of the model fit to 0.04 pixels")
    text = read_colmap_points(cameras)
    (cameras / "points3D.bin").write_bytes(
        struct.pack("<Q", 3)
        + b"".join(
            struct.pack("<Q3d3BdQII", i + 1, i, 1, 2, 0, 0, 0, e, 1, 1, 1) for i, e in enumerate((0.02, 0.04, 0.06))
        )
    )
    for one, other in zip(read_colmap_points(cameras), text, strict=True):
        np.testing.assert_array_equal(one, other)
    data = (cameras / "points3D.bin").read_bytes()
    for damaged in (data[:-5], struct.pack("<Q", 2**60) + data[8:]):
        (cameras / "points3D.bin").write_bytes(damaged)
        with pytest.raises(InputError, match=r"points3D\.bin is"):
            read_colmap_points(cameras)


def sync_report(folder: Path, notes: tuple[str, ...] = (), used: str = "flash", **estimates: float) -> None:
    methods = {name: {"offset_frames": 0.0, "confidence": value} for name, value in estimates.items()}
    record = {
        "cameras": {name: {"offset_seconds": 0.0} for name in POSES},
        "pairs": [{"cameras": ["cam0", "cam1"], "used": used, "estimates": methods, "undecided": {}}],
        "notes": list(notes),
    }
    (folder / "sync.json").write_text(json.dumps(record))


def test_the_synchronisation_is_told_with_its_confidence(small: Path):
    said(small, "note", "no camera has an offset", "sync first")
    sync_report(small, flash=0.96, sound=0.9)
    said(small, "note", "cam0 and cam1 are +0.00 frames apart by flash", "sound +0.00 (confidence 0.90)")
    sync_report(small, used="motion", motion=0.99)
    said(small, "warning", "by motion", "nothing else confirms it", "look at a fast moment")
    sync_report(small, notes=("cam0 and cam1: sound says otherwise",), flash=0.9, sound=0.9)
    said(small, "warning", "sound says otherwise")
    (small / "capture.toml").write_text((small / "capture.toml").read_text() + "offset = 0.1\n")
    said(small, "note", "cam1 has the offset 0.1 s", "measured 0 s")
    (small / "sync.json").write_text("[]")
    said(small, "warning", "sync.json is not what sync writes")


def test_little_that_the_cameras_share_is_warned_of(small: Path):
    toml = small / "capture.toml"
    toml.write_text(toml.read_text().replace("frames = 12\n", "") + "offset = 0.3\n")
    for name in ("keypoints", "masks", "selected_frames"):
        toml.write_text(re.sub(rf"{name} = .*\n", "", toml.read_text()))
    said(small, "warning", "share 3 frames", "25% of cam0.mp4", "jaxmocap sync")


def test_a_picture_of_the_cameras_is_drawn(small: Path, tmp_path: Path, capsys):
    picture = tmp_path / "cameras.png"
    assert run(["check", str(small), "--picture", str(picture)]) == 0
    assert picture.read_bytes()[:4] == b"\x89PNG"
    assert run(["check", str(small), "--picture", str(tmp_path / "cameras.jpg")]) == 2
    assert ".png was expected" in capsys.readouterr().err
