"""`refine-cameras` on a capture on disk whose cameras and offset are off in known ways."""

import dataclasses
import json
import shutil
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
import pytest
from joint_world import drift
from scipy.spatial.transform import Rotation

import jaxmocap as jm
from jaxmocap._cli import run
from jaxmocap._results import InputError
from jaxmocap.calibration import _worker
from jaxmocap.character import landmark_positions
from jaxmocap.geometry import align_cameras, camera_residuals
from jaxmocap.motion import Motion, cameras_at
from jaxmocap.observation import BODY_25
from jaxmocap.synthetic import make_capture, write_capture
from jaxmocap.synthetic._motion import dance

COUNT, LATE = 24, 0.011
SIZE = (160, 90)


def landmarks(character, seconds: np.ndarray) -> np.ndarray:
    poses = dance(character.skeleton, seconds, 1.0)
    return np.asarray(jax.vmap(lambda pose: landmark_positions(character.skeleton, pose))(poses), float)


def project(pose: np.ndarray, matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    image = (points @ pose[:3, :3].T + pose[:3, 3]) @ matrix.T
    return image[:, :2] / image[:, 2:]


def write_keypoints(folder: Path, shown, poses: np.ndarray, matrices: np.ndarray) -> None:
    """A detector's, at every frame; the second camera began `LATE` seconds later than its offset says."""
    folder.mkdir()
    generator, names = np.random.default_rng(1), shown.character.skeleton.landmark_names
    for camera, name in enumerate(shown.cameras.names):
        places = landmarks(shown.character, shown.timestamps + LATE * camera)
        for frame in range(COUNT):
            person = np.zeros((25, 3))
            for point, parts in BODY_25.items():
                place = places[frame, [names.index(part) for part in parts]].mean(0)
                pixel = project(poses[camera, frame], matrices[camera], place[None])[0]
                person[point] = [*pixel + generator.normal(0, 0.15, 2), 0.9]
            people = {"people": [{"pose_keypoints_2d": person.ravel().tolist()}]}
            (folder / f"{name}_{frame:05d}_keypoints.json").write_text(json.dumps(people))


def write_model(folder: Path, names: tuple[str, ...], poses: np.ndarray, wrong: np.ndarray, matrix: np.ndarray) -> None:
    """A COLMAP model with `wrong` poses, and 200 points with what the true `poses` see of them."""
    generator = np.random.default_rng(2)
    points = generator.uniform([-3, 0, -4], [3, 3, -1], (200, 3))
    shutil.rmtree(folder)
    folder.mkdir()
    params = f"{matrix[0, 0]} {matrix[0, 2]} {matrix[1, 2]}"
    cameras = [f"{camera + 1} SIMPLE_PINHOLE {SIZE[0]} {SIZE[1]} {params}" for camera in range(len(names))]
    (folder / "cameras.txt").write_text("\n".join(cameras) + "\n")
    lines, tracks = [], [[] for _ in points]
    for camera, name in enumerate(names):
        for frame in range(COUNT):
            image = len(lines) // 2 + 1
            pixels = project(poses[camera, frame], matrix, points) + generator.normal(0, 0.06, (len(points), 2))
            seen = np.flatnonzero(((pixels > 0) & (pixels < SIZE)).all(1))
            for slot, point in enumerate(seen):
                tracks[point].append(f"{image} {slot}")
            x, y, z, w = Rotation.from_matrix(wrong[camera, frame, :3, :3]).as_quat()
            values = " ".join(repr(float(v)) for v in (w, x, y, z, *wrong[camera, frame, :3, 3]))
            lines.append(f"{image} {values} {camera + 1} {name}/{frame:05d}.png")
            lines.append(" ".join(f"{pixels[p, 0]} {pixels[p, 1]} {p + 1}" for p in seen))
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    near = points + generator.normal(0, 0.02, points.shape)
    rows = [
        f"{i + 1} {x} {y} {z} 0 0 0 0.1 {' '.join(t)}"
        for i, ((x, y, z), t) in enumerate(zip(near, tracks, strict=True))
        if t
    ]
    (folder / "points3D.txt").write_text("\n".join(rows) + "\n")


@pytest.fixture(scope="module")
def world(tmp_path_factory) -> tuple[Path, np.ndarray]:
    """A folder with a capture, its result and detections, and the true poses."""
    folder = tmp_path_factory.mktemp("refine")
    shown = make_capture(COUNT, SIZE)
    film = write_capture(shown, folder / "film")
    poses, matrices = np.asarray(shown.cameras.cam_from_world, float), np.asarray(shown.cameras.intrinsics, float)
    generator, wrong = np.random.default_rng(0), poses.copy()
    for camera in range(len(poses)):
        twist = drift(COUNT, np.radians(0.3), 0.015, generator)
        wrong[camera, :, :3] = Rotation.from_rotvec(twist[:, :3]).as_matrix() @ wrong[camera, :, :3]
        wrong[camera, :, :3, 3] += twist[:, 3:]
    write_model(film / "cameras", shown.cameras.names, poses, wrong, matrices[0])
    write_keypoints(folder / "detections", shown, poses, matrices)
    cameras = cameras_at(jm.Capture.open(film).cameras, np.arange(COUNT))
    motion = Motion.from_poses(shown.character, shown.poses, np.arange(COUNT), shown.timestamps, cameras=cameras)
    motion.save(folder / "result")
    return folder, poses


@pytest.fixture
def film(world, tmp_path) -> Path:
    return Path(shutil.copytree(world[0] / "film", tmp_path / "film"))


def errors(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    found, true = (np.asarray(poses, float).reshape(-1, 4, 4) for poses in (found, true))
    centres, angles = camera_residuals(align_cameras(found, true), found, true)
    return float(centres.mean()), float(np.degrees(angles.mean()))


def test_of_very_many_points_some_are_taken_with_all_their_sightings(film, tmp_path, monkeypatch):
    """Images left out would keep their old poses between the refined ones."""
    monkeypatch.setattr(_worker, "_MOST_SIGHTINGS", 2000)
    (tmp_path / "model.json").write_text(json.dumps(str(film / "cameras")))
    _worker.extract_tracks(tmp_path)
    with np.load(tmp_path / "tracks.npz") as tracks:
        assert len(tracks["names"]) == 2 * COUNT
        assert 1000 < len(tracks["pose_of"]) < 2200
        assert set(tracks["pose_of"].tolist()) == set(range(2 * COUNT))
        assert set(tracks["point_of"].tolist()) == set(range(len(tracks["points"])))


@pytest.mark.slow
def test_a_capture_is_refined_in_place(world, film, capsys):
    folder, true = world
    before = errors(np.asarray(jm.Capture.open(film).cameras.cam_from_world), true)
    old = {file: file.read_bytes() for file in (film / "cameras").iterdir()}
    arguments = ["refine-cameras", film, folder / "result", "--detections", folder / "detections", "--json"]
    assert run([str(argument) for argument in arguments]) == 0
    answer = json.loads(capsys.readouterr().out)
    capture = jm.Capture.open(film)
    assert capture.cameras_path == film / "cameras-2"
    after = errors(np.asarray(capture.cameras.cam_from_world), true)
    assert after[0] < 0.3 * before[0]
    assert after[1] < 0.3 * before[1]
    assert capture.offsets[0] == 0
    found = answer["cameras"]["cam1"]
    assert capture.offsets[1] == pytest.approx(LATE, abs=0.004)  # of 33 ms between frames
    assert abs(capture.offsets[1] - LATE) < 3 * found["late_deviation_seconds"]
    assert found["late_seconds"] == pytest.approx(capture.offsets[1], abs=1e-4)
    assert found["turned_degrees"] < 1.0  # the world stays where it was
    assert answer["residuals_pixels"]["background"][1] < 0.2 < answer["residuals_pixels"]["background"][0]
    assert {file: file.read_bytes() for file in (film / "cameras").iterdir()} == old
    record = json.loads((film / "cameras-2" / "refinement.json").read_text())
    assert record == {key: value for key, value in answer.items() if key != "folder"}
    notes = [finding.message for finding in jm.check(film) if finding.severity == "note"]
    assert sum("refined with the tracked body" in note for note in notes) == 2
    points, residual = jm.camera.read_colmap_points(film / "cameras-2")
    assert len(points) > 150
    assert np.median(residual) < 0.2


def test_cameras_without_points_are_held_and_the_time_is_found(world, film):
    folder, _ = world
    (film / "cameras" / "points3D.txt").write_text("")
    found = jm.refine_cameras(jm.Capture.open(film), folder / "result", detections=folder / "detections")
    assert found.names == ()
    np.testing.assert_allclose(found.cameras.cam_from_world, jm.Capture.open(film).cameras.cam_from_world, atol=1e-5)
    second = found.record["cameras"]["cam1"]
    assert second["late_seconds"] == pytest.approx(LATE, abs=0.005)
    sure = second["late_seconds"] > 2 * second["late_deviation_seconds"]  # the held cameras are wrong, which it shows
    assert found.offsets[1] == pytest.approx(second["late_seconds"] if sure else 0.0, abs=1e-4)


def test_what_does_not_belong_together_is_refused(world, film, tmp_path, capsys):
    folder, _ = world
    motion = Motion.load(folder / "result")
    before = {file: file.read_bytes() for file in film.rglob("*") if file.is_file()}
    with pytest.raises(InputError, match="with --detections"):
        jm.refine_cameras(film, motion[1:9])  # the capture itself has keypoints at frames 0 and 12
    with pytest.raises(InputError, match="not all among"):
        jm.refine_cameras(film, motion[:3], detections=folder / "detections")
    assert motion.cameras is not None
    shifted = motion.cameras.cam_from_world.at[..., 0, 3].add(0.1)
    other = eqx.tree_at(lambda cameras: cameras.cam_from_world, motion.cameras, shifted)
    with pytest.raises(InputError, match="other cameras"):
        jm.refine_cameras(film, dataclasses.replace(motion, cameras=other), detections=folder / "detections")
    assert run(["refine-cameras", str(film), str(tmp_path / "nowhere")]) == 2
    assert "nowhere" in capsys.readouterr().err
    assert {file: file.read_bytes() for file in film.rglob("*") if file.is_file()} == before
