"""The child process: structure from motion of one capture, apart from the program, which survives its crashes.

`python -m jaxmocap.calibration._worker reconstruct FOLDER` reads `FOLDER/job.json`, writes `FOLDER/model` (COLMAP,
binary) and `FOLDER/result.npz`, and reports progress as JSON lines on standard output. Exit code 2 with a line
`{"error": ...}` means that the footage cannot be used. `transform` then moves the model into the metric world; `tracks`
reads a finished model out and `poses` replaces its poses.
"""

import json
import sys
from pathlib import Path

import cv2  # noqa: F401  (before pycolmap: the other order crashes)
import numpy as np
import pycolmap

from jaxmocap._results import InputError

from ._adjust import adjust, median_depth, observations
from ._finished_model import read_tracks, replace_poses
from ._footage import Footage
from ._mapping import map_key_frames
from ._matching import Report, match_key_frames
from ._pairs import Place
from ._refusals import refuse_motionless
from ._registration import Model, place_other_frames
from ._repair import Repairs, departures, path_of, remove_outliers, repair
from ._uncertainty import Network, PoseDeviation, deviation_given_points, pose_deviation

_MOST_IN_NETWORK = 120
_MAD_TO_SIGMA = 1.4826


def reconstruct(footage: Footage, work: Path, report: Report) -> tuple[Model, Repairs]:
    """A model with a pose for every frame: key frames together, then every other frame placed among their points.

    Bundle adjustment ends with the key frames: with all frames of a capture of two cameras and 196 frames it took a
    quarter of the time and moved the centres away from the truth, from 0.15 to 0.20 cm, since a texture's false match
    repeats from frame to frame. Raises `InputError` for footage that cannot be used.
    """
    database = work / "database.db"
    features = match_key_frames(footage, database, report)
    reconstruction = map_key_frames(footage, database, work, report)
    report("bundle adjustment", 0, 1)
    adjust(reconstruction, footage.threads, refine_focal=not footage.focal_known)
    report("bundle adjustment", 1, 1)
    model = Model(footage, reconstruction, features)
    refuse_motionless(model)
    off = remove_outliers(model)
    sightings = place_other_frames(model, report)
    repairs = repair(model, sightings, report)
    outliers = sorted({*off, *repairs.outliers})
    again = sorted({*off, *repairs.placed_again} - {*repairs.interpolated})
    return model, Repairs(outliers, again, sorted(repairs.interpolated))


def network_of(model: Model, places: list[Place]) -> Network:
    """The bundle adjustment of these frames, with the residuals' robust standard deviation."""
    reconstruction = model.reconstruction
    lenses = sorted(reconstruction.cameras)
    seen = [observations(reconstruction, model.images[place]) for place in places]
    ids = np.concatenate([points for _, points, _ in seen])
    unique, point_of = np.unique(ids, return_inverse=True)
    residuals = np.concatenate([residual for _, _, residual in seen])
    poses = [model.pose(place) for place in places]
    return Network(
        cam_from_world=np.stack([pose for pose in poses if pose is not None]),
        lens=np.array([camera for camera, _ in places]),
        focal=np.array([reconstruction.cameras[i].params[0] for i in lenses]),
        radial=np.array([reconstruction.cameras[i].params[3] for i in lenses]),
        points=np.array([reconstruction.points3D[int(i)].xyz for i in unique]),
        pose_of=np.repeat(np.arange(len(places)), [len(points) for _, points, _ in seen]),
        point_of=point_of,
        sigma=_MAD_TO_SIGMA * float(np.median(np.abs(residuals))),
    )


def _uncertainty(model: Model, places: list[Place], interpolated: list[Place]) -> PoseDeviation:
    """Of the network of key frames, with each other frame's own noise besides; interpolated ones as the path shakes.

    A camera sees one point in many frames with errors that are alike, since they are the texture's and the
    compression's, so in the network all of a camera's sightings of a point count as one: deviations grow by the root
    of their number.
    """
    usable = [place for place in places if place not in interpolated]
    keys = [place for place in usable if place in model.features]
    keys = keys[:: -(-len(keys) // _MOST_IN_NETWORK)]
    seen = network_of(model, keys)
    alike = len(seen.pose_of) / len(np.unique(np.stack([seen.lens[seen.pose_of], seen.point_of]), axis=1).T)
    network = pose_deviation(seen._replace(sigma=seen.sigma * np.sqrt(alike)))
    paths = [departures(model, camera) for camera in range(len(model.footage.videos))] if interpolated else []
    own = deviation_given_points(network_of(model, usable))
    distance = median_depth(model.reconstruction)
    centre, angle = np.empty(len(places)), np.empty(len(places))
    for index, (camera, frame) in enumerate(places):
        nearest = min(range(len(keys)), key=lambda k: (keys[k][0] != camera, abs(keys[k][1] - frame)))
        shared = network.centre[nearest], network.angle[nearest]
        if (camera, frame) in interpolated:
            path = paths[camera]
            gap = min((abs(f - frame) for c, f in usable if c == camera), default=1)
            single = path.usual_shift * distance * gap, path.usual_turn * gap
        elif (camera, frame) in keys:
            single = 0.0, 0.0
        else:
            at = usable.index((camera, frame))
            single = own.centre[at], own.angle[at]
        centre[index], angle[index] = np.hypot(shared[0], single[0]), np.hypot(shared[1], single[1])
    return PoseDeviation(centre, angle)


def write_result(model: Model, repairs: Repairs, folder: Path) -> None:
    """Poses, intrinsics, points and what is known about their quality, in the model's own units and axes."""
    footage, reconstruction = model.footage, model.reconstruction
    places = [(camera, frame) for camera, video in enumerate(footage.videos) for frame in video.frames]
    deviation = _uncertainty(model, places, repairs.interpolated)
    seen = [observations(reconstruction, model.images[place])[2] for place in places]
    residual = np.array([np.median(np.linalg.norm(r, axis=1)) if len(r) else np.nan for r in seen])
    poses = np.concatenate([path_of(model, camera)[1] for camera in range(len(footage.videos))])
    tracks = [point.track.length() for point in reconstruction.points3D.values()]
    np.savez(
        folder / "result.npz",
        places=np.array(places),
        cam_from_world=poses,
        lens=np.stack([reconstruction.cameras[c + 1].params for c in range(len(footage.videos))]),
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


_SHORT = {"transform": transform, "tracks": read_tracks, "poses": replace_poses}


def _tell(**message: object) -> None:
    print(json.dumps(message), file=sys.__stdout__, flush=True)


def main(task: str, folder: Path) -> int:
    """Do the task, `reconstruct` or one of the short ones, in `folder`; the exit code."""
    pycolmap.logging.minloglevel = 2
    if task in _SHORT:
        _SHORT[task](folder)
        return 0
    footage = Footage.from_file(folder / "job.json")
    try:
        model, repairs = reconstruct(footage, folder, lambda stage, done, total: _tell(progress=[stage, done, total]))
        write_result(model, repairs, folder)
    except InputError as error:
        _tell(error=str(error))
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2])))
