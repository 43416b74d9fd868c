"""The child process: structure from motion of one capture, apart from the program, which survives its crashes.

`python -m jaxmocap.calibration._worker reconstruct FOLDER` reads `FOLDER/job.json`, writes `FOLDER/model` (COLMAP,
binary) and `FOLDER/result.npz`, and reports progress as JSON lines on standard output. Exit code 2 with a line
`{"error": ...}` means that the footage cannot be used. `static` does the same for cameras that stand still, from the
person's keypoints in `FOLDER/person.npz`, and `pictures` for single pictures. `transform` then moves the model into the
metric world. For the refinement of a finished model, `tracks` reads out its tracks and `poses` replaces its poses.
"""

import json
import sys
from pathlib import Path

import cv2  # noqa: F401  (before pycolmap: the other order crashes)
import numpy as np
import pycolmap

from jaxmocap._results import InputError

from ._following import place_other_frames
from ._footage import Footage, Report
from ._mapping import map_key_frames, median_depth, observations
from ._matching import match_key_frames
from ._picture_worker import map_pictures
from ._registration import Model
from ._repair import Repairs, path_of, refuse_motionless, remove_outliers, repair
from ._static_worker import reconstruct_static
from ._uncertainty import deviation_of_places

_MOST_SIGHTINGS = 400_000


def reconstruct(footage: Footage, work: Path, report: Report) -> tuple[Model, Repairs]:
    """Make a model with a pose for every frame: key frames together, then every other frame placed among their points.

    Bundle adjustment ends with the key frames: with all frames of a capture of two cameras and 196 frames it took a
    quarter of the time and moved the centres away from the truth, from 0.15 to 0.20 cm, since a texture's false match
    repeats from frame to frame. Raises `InputError` for footage that cannot be used.
    """
    database, recorded, footage = work / "database.db", footage, footage.reduced()
    features = match_key_frames(footage, database, report)
    reconstruction = map_key_frames(footage, database, work, report)
    for image in reconstruction.images.values():
        image.name = image.name.replace("+", " ")  # see `VideoFootage.listed_name`
    model = Model(footage, reconstruction, features)
    refuse_motionless(model)
    off = remove_outliers(model)
    sightings = place_other_frames(model, report)
    repairs = repair(model, sightings, report)
    outliers = sorted({*off, *repairs.outliers})
    again = sorted({*off, *repairs.placed_again} - {*repairs.interpolated})
    _enlarge(reconstruction, recorded)
    model.footage = recorded
    return model, Repairs(outliers, again, sorted(repairs.interpolated))


def _enlarge(reconstruction: pycolmap.Reconstruction, recorded: Footage) -> None:
    """Bring lenses and points from the pixels that were looked at to those of the videos as recorded."""
    for number, video in enumerate(recorded.videos, start=1):
        lens = reconstruction.cameras[number]
        factor = np.array(video.size) / [lens.width, lens.height]
        if (factor == 1).all():
            continue
        lens.rescale(*video.size)
        for image in reconstruction.images.values():
            if image.camera_id == number:
                for point in image.points2D:
                    point.xy = factor * point.xy


def write_result(model: Model, repairs: Repairs, folder: Path) -> None:
    """Write poses, intrinsics, points and what is known about their quality, in the model's own units and axes."""
    footage, reconstruction = model.footage, model.reconstruction
    places = [(camera, frame) for camera, video in enumerate(footage.videos) for frame in video.frames]
    deviation = deviation_of_places(model, places, repairs.interpolated)
    seen = [observations(reconstruction, model.images[place])[2] for place in places]
    residual = np.array([np.median(np.linalg.norm(r, axis=1)) if len(r) else np.nan for r in seen])
    poses = np.concatenate([path_of(model, camera)[1] for camera in range(len(footage.videos))])
    lenses = [reconstruction.cameras[c + 1].params for c in range(len(footage.videos))]
    tracks = [point.track.length() for point in reconstruction.points3D.values()]
    np.savez(
        folder / "result.npz",
        places=np.array(places),
        cam_from_world=poses,
        intrinsics=np.array([[[f, 0, x], [0, f, y], [0, 0, 1]] for f, x, y, _ in lenses]),
        distortion=np.array([[k1, 0, 0, 0, 0] for *_, k1 in lenses]),
        points=np.array([point.xyz for point in reconstruction.points3D.values()]),
        distance=median_depth(reconstruction),
        track_lengths=np.array(tracks),
        residual=residual,
        num_observations=np.array([len(r) for r in seen]),
        centre_deviation=deviation.centre,
        angle_deviation=deviation.angle,
        outliers=np.array(repairs.outliers, int).reshape(-1, 2),
        placed_again=np.array(repairs.placed_again, int).reshape(-1, 2),
        interpolated=np.array(repairs.interpolated, int).reshape(-1, 2),
    )
    (folder / "model").mkdir()
    reconstruction.write_binary(folder / "model")


def transform(folder: Path) -> None:
    """Write `model` to `cameras`, moved by the similarity in `similarity.json` (metric world from model)."""
    similarity = json.loads((folder / "similarity.json").read_text(encoding="utf-8"))
    reconstruction = pycolmap.Reconstruction(folder / "model")
    rotation = pycolmap.Rotation3d(np.array(similarity["rotation"], float))
    reconstruction.transform(pycolmap.Sim3d(similarity["scale"], rotation, np.array(similarity["translation"], float)))
    (folder / "cameras").mkdir()
    reconstruction.write_binary(folder / "cameras")


def extract_tracks(folder: Path) -> None:
    """Write `tracks.npz` from the model that `model.json` names: images, their poses, points, and what sees what.

    Of a very long capture only every so many points are taken, with all that see them.
    """
    model = _model(folder)
    images = sorted((image for image in model.images.values() if image.has_pose), key=lambda image: image.name)
    every = max(1, -(-sum(image.num_points3D for image in images) // _MOST_SIGHTINGS))
    points = {number: index for index, number in enumerate(sorted(model.points3D)[::every])}
    poses = np.tile(np.eye(4), (len(images), 1, 1))
    pose_of, point_of, pixels = [], [], []
    for index, image in enumerate(images):
        poses[index, :3] = image.cam_from_world().matrix()
        for point in image.points2D:
            if point.has_point3D() and point.point3D_id in points:
                pose_of.append(index)
                point_of.append(points[point.point3D_id])
                pixels.append(point.xy)
    np.savez(
        folder / "tracks.npz",
        names=np.array([image.name for image in images], np.str_),
        cam_from_world=poses,
        points=np.array([model.points3D[number].xyz for number in points]).reshape(-1, 3),
        pose_of=np.array(pose_of, int),
        point_of=np.array(point_of, int),
        pixels=np.array(pixels, float).reshape(-1, 2),
    )


def replace_poses(folder: Path) -> None:
    """Write the model to `cameras` with the poses and the factors of focal lengths of `poses.npz`.

    Its points are adjusted to them.
    """
    model = _model(folder)
    with np.load(folder / "poses.npz", allow_pickle=False) as arrays:
        poses = dict(zip(arrays["names"].tolist(), arrays["cam_from_world"], strict=True))
        factors = dict(zip(arrays["cameras"].tolist(), arrays["factors"], strict=True))
    scaled = set()
    for image in model.images.values():
        name = image.name.rsplit("/", 1)[0]
        if image.name in poses:
            rigid = pycolmap.Rigid3d(poses[image.name][:3])
            model.frames[image.frame_id].set_cam_from_world(image.camera_id, rigid)
        if name in factors and image.camera_id not in scaled:
            scaled.add(image.camera_id)
            camera = model.cameras[image.camera_id]
            parameters = np.array(camera.params)
            parameters[camera.focal_length_idxs()] *= factors[name]
            camera.params = parameters.tolist()
    for number in [number for number, point in model.points3D.items() if point.track.length() < 2]:
        model.delete_point3D(number)
    if model.num_points3D():
        options = pycolmap.BundleAdjustmentOptions()
        options.print_summary = False
        options.refine_focal_length = options.refine_extra_params = options.refine_principal_point = False
        options.refine_rig_from_world = options.refine_sensor_from_rig = False
        options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
        pycolmap.bundle_adjustment(model, options)
        model.update_point_3d_errors()
    (folder / "cameras").mkdir()
    model.write_binary(folder / "cameras")


def _model(folder: Path) -> pycolmap.Reconstruction:
    return pycolmap.Reconstruction(json.loads((folder / "model.json").read_text(encoding="utf-8")))


_SHORT = {"transform": transform, "tracks": extract_tracks, "poses": replace_poses}


def _tell(**message: object) -> None:
    print(json.dumps(message), file=sys.__stdout__, flush=True)


def _report(stage: str, done: int, total: int) -> None:
    _tell(progress=[stage, done, total])


def main(task: str, folder: Path) -> int:
    """Do the task, `reconstruct`, `static`, `pictures` or one of the short ones, in `folder`; return the exit code."""
    pycolmap.logging.minloglevel = 2
    if task in _SHORT:
        _SHORT[task](folder)
        return 0
    try:
        if task == "pictures":
            map_pictures(folder, _report)
            return 0
        footage = Footage.from_file(folder / "job.json")
        if task == "static":
            reconstruct_static(footage, folder, _report)
        else:
            write_result(*reconstruct(footage, folder, _report), folder)
    except InputError as error:
        _tell(error=str(error))
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2])))
