"""Bundle adjustment of a whole model with a robust loss, and dropping what does not fit."""

import cv2  # noqa: F401  (before pycolmap: the other order crashes)
import numpy as np
import pycolmap

_LOSS_SCALE = 1.0  # pixels at a width of 960
_LARGEST_RESIDUAL = 2.0
_SMALLEST_ANGLE = 1.0  # degrees between the rays of a point


def adjust(model: pycolmap.Reconstruction, threads: int, refine_focal: bool = True, rounds: int = 2) -> None:
    """Refine poses, points, focal lengths and the radial distortion of `model`, with Cauchy's loss; drop observations
    that stay off and points seen from one direction only. Without the loss focal lengths come out 1 % long."""
    scale = max(max(camera.width, camera.height) for camera in model.cameras.values()) / 960
    for _ in range(rounds):
        options = pycolmap.BundleAdjustmentOptions()
        options.print_summary = False
        options.refine_focal_length = refine_focal
        options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
        options.ceres.loss_function_scale = _LOSS_SCALE * scale
        options.ceres.solver_options.num_threads = threads
        options.ceres.solver_options.max_num_iterations = 60
        options.ceres.solver_options.function_tolerance = 1e-7
        pycolmap.bundle_adjustment(model, options)
        pycolmap.ObservationManager(model).filter_all_points3D(_LARGEST_RESIDUAL * scale, _SMALLEST_ANGLE)


def median_depth(model: pycolmap.Reconstruction) -> float:
    """The median over images of the median depth of the points they see: the distance to the scene."""
    depths = []
    for image in model.images.values():
        if image.has_pose and image.num_points3D:
            seen = [model.points3D[p.point3D_id].xyz for p in image.points2D if p.has_point3D()]
            pose = image.cam_from_world().matrix()
            depths.append(np.median(np.array(seen) @ pose[2, :3] + pose[2, 3]))
    return float(np.median(depths))


def observations(model: pycolmap.Reconstruction, image_id: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of one image: pixels seen, ids of the points, and residuals in pixels (n, 2)."""
    image = model.images[image_id]
    seen = [point for point in image.points2D if point.has_point3D()]
    pixels = np.array([point.xy for point in seen]).reshape(-1, 2)
    ids = np.array([point.point3D_id for point in seen], int)
    places = np.array([model.points3D[int(i)].xyz for i in ids]).reshape(-1, 3)
    pose = image.cam_from_world().matrix()
    again = model.cameras[image.camera_id].img_from_cam(places @ pose[:, :3].T + pose[:, 3])
    return pixels, ids, np.reshape(np.asarray(again), (-1, 2)) - pixels
