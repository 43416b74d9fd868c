"""The child process' part for cameras that stand still: from keypoints to a model and what is known of it."""

from pathlib import Path

import numpy as np
import pycolmap

from ._footage import Footage, Report
from ._person_scene import Beliefs, believed_lengths, person_keypoints
from ._static_rig import StaticRig, find_static_rig

_FOCAL_SIGMA = 0.15  # relative, of a guess: phones filming are between 0.7 and 1.2 times the longer side
_TOLD_SIGMA = 0.08  # of what the video says, since phones crop what they film
_ALIKE = 0.1  # of the ratio of two phones' focal lengths
_LATE = 0.5  # frames, of what synchronisation leaves open


def reconstruct_static(footage: Footage, work: Path, report: Report) -> None:
    """Read `person.npz`, write `result.npz` and `model` as for moving cameras.

    Raises `InputError` for keypoints that do not tell where the cameras stand.
    """
    with np.load(work / "person.npz", allow_pickle=False) as arrays:
        person = dict(arrays)
    counted = person["counted"]  # of a long capture every so many, once neighbours have told how each moves
    seen = person_keypoints(person["keypoints"], person["seconds"]).at(counted)
    matrices, distortion = person["intrinsics"], person["distortion"]
    focal, centre = matrices[:, 0, 0], matrices[:, :2, 2]
    told = [0.0 if v.focal_known else _TOLD_SIGMA if v.focal_told else _FOCAL_SIGMA for v in footage.videos]
    lengths = dict(zip(person["bones"].tolist(), person["lengths"].tolist(), strict=True))
    beliefs = Beliefs(focal, np.array(told), _ALIKE, _LATE * float(person["frame"]), believed_lengths(lengths))
    names = [video.name for video in footage.videos]
    found = find_static_rig(seen, centre, beliefs, names, footage.seed, report)
    stretch = found.rig.focal / focal
    matrices = matrices.copy()
    matrices[:, 0, 0] *= stretch
    matrices[:, 1, 1] *= stretch
    _write_model(footage, found, matrices, distortion, work / "model")
    _write_result(footage, found, matrices, distortion, person["video_frames"][:, counted], work / "result.npz")


def _write_result(
    footage: Footage,
    found: StaticRig,
    matrices: np.ndarray,
    distortion: np.ndarray,
    video_frames: np.ndarray,
    file: Path,
) -> None:
    places = np.array([(camera, frame) for camera, video in enumerate(footage.videos) for frame in video.frames])
    camera = places[:, 0]
    residual, count = np.full(len(places), np.nan), np.zeros(len(places), int)
    for number in range(len(footage.videos)):
        own = dict(zip(video_frames[number].tolist(), range(video_frames.shape[1]), strict=True))
        for row in np.flatnonzero(camera == number):
            off = found.residual[number, own[int(places[row, 1])]] if int(places[row, 1]) in own else np.zeros(0)
            count[row] = np.isfinite(off).sum()
            residual[row] = np.median(off[np.isfinite(off)]) if count[row] else np.nan
    poses = found.rig.cam_from_world
    finite = found.points[np.isfinite(found.points).all(-1)]
    depth = np.median(finite @ poses[:, 2, :3].T + poses[:, 2, 3], axis=0)
    nothing = np.zeros((0, 2), int)
    np.savez(
        file,
        places=places,
        cam_from_world=poses[camera],
        intrinsics=matrices,
        distortion=distortion,
        points=np.zeros((0, 3)),
        distance=float(np.median(depth)),
        track_lengths=np.zeros(0),
        residual=residual,
        num_observations=count,
        centre_deviation=found.centre_deviation[camera],
        angle_deviation=found.angle_deviation[camera],
        outliers=nothing,
        placed_again=nothing,
        interpolated=nothing,
        joints=found.points,
        late=found.rig.late,
    )


def _write_model(footage: Footage, found: StaticRig, matrices: np.ndarray, distortion: np.ndarray, out: Path) -> None:
    """Write a COLMAP model in which every frame of a camera has its pose, without points."""
    model = pycolmap.Reconstruction()
    number = 0
    for camera, (video, matrix, bent) in enumerate(zip(footage.videos, matrices, distortion, strict=True)):
        width, height = video.size
        name, parameters = _lens(matrix, bent)
        lens = pycolmap.Camera(model=name, width=width, height=height, params=parameters, camera_id=camera + 1)
        model.add_camera_with_trivial_rig(lens)
        rigid = pycolmap.Rigid3d(found.rig.cam_from_world[camera, :3])
        for frame in video.frames:
            number += 1
            image = pycolmap.Image(
                name=video.image_name(frame), keypoints=np.zeros((0, 2)), camera_id=camera + 1, image_id=number
            )
            model.add_image_with_trivial_frame(image, rigid)
    out.mkdir()
    model.write_binary(out)


def _lens(matrix: np.ndarray, distortion: np.ndarray) -> tuple[str, list[float]]:
    """COLMAP's camera model and its parameters: the moving cameras' unless more is known."""
    fx, fy, cx, cy = (float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    k1, k2, p1, p2, k3 = (float(value) for value in distortion)
    if fx == fy and not any((k2, p1, p2, k3)):
        return "SIMPLE_RADIAL", [fx, cx, cy, k1]
    if not k3:
        return "OPENCV", [fx, fy, cx, cy, k1, k2, p1, p2]
    return "FULL_OPENCV", [fx, fy, cx, cy, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]
