"""A COLMAP model on disk: its tracks read out, and its poses replaced. Runs in the child process, as pycolmap does."""

import json
from pathlib import Path

import cv2  # noqa: F401  (before pycolmap: the other order crashes)
import numpy as np
import pycolmap

_MOST_SIGHTINGS = 400_000


def read_tracks(folder: Path) -> None:
    """Write `tracks.npz` from the model that `model.json` names: images, their poses, points, and what sees what. Of a
    very long capture only every so many images are taken."""
    model = _model(folder)
    points = {number: index for index, number in enumerate(sorted(model.points3D))}
    images = sorted((image for image in model.images.values() if image.has_pose), key=lambda image: image.name)
    images = images[:: max(1, -(-sum(image.num_points3D for image in images) // _MOST_SIGHTINGS))]
    poses = np.tile(np.eye(4), (len(images), 1, 1))
    pose_of, point_of, pixels = [], [], []
    for index, image in enumerate(images):
        poses[index, :3] = image.cam_from_world().matrix()
        for point in image.points2D:
            if point.has_point3D():
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
    """Write the model to `cameras` with the poses and focal lengths' factors of `poses.npz`, its points adjusted to
    them."""
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
