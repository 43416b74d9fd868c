"""Structure from motion of the key frames of all cameras in one model (incremental, Schoenberger and Frahm 2016), and
bundle adjustment of that model."""

from collections.abc import Iterator
from pathlib import Path

import cv2  # noqa: F401  (before pycolmap: the other order crashes)
import numpy as np
import pycolmap

from jaxmocap._results import InputError

from ._footage import Footage, Report
from ._matching import ENOUGH, best_pairs_across
from ._placeable import advise_keys, longest_run
from ._registration import Model

THREADS = 1
"""Of COLMAP's mapper and bundle adjustment: with two, sums are of another order in some runs, and the same seed gives
other bits. One takes a tenth longer to calibrate two moving phones (3 s of film, two cores).
"""
_PAIRS = 3  # to begin with
_FOCAL_FACTORS = (1.0, 1.4, 0.7)  # of the guess
_SAME_FOCAL = 0.03
_NEARLY_ALL = 0.9
FOCAL_RANGE = (0.3, 6.0)  # times the longer side of the image
_LOSS_SCALE = 1.0  # pixels at a width of 960
_LARGEST_RESIDUAL = 2.0
_SMALLEST_ANGLE = 1.0  # degrees between the rays of a point


def map_key_frames(footage: Footage, database: Path, work: Path, report: Report) -> pycolmap.Reconstruction:
    """Reconstruct the key frames of all cameras in one model and return it, bundle-adjusted, in units of its own.

    Mapping starts from a pair of images of two different cameras, which stand apart: a single handheld camera moves too
    little to determine its focal length. While images are being added, an unknown focal length (pixels) keeps a guessed
    value, because a few images determine it badly and the remaining ones would then not fit; bundle adjustment frees it
    once most key frames are placed.

    A bad start gives a model that is flat or far away. Mapping is therefore repeated from other pairs and guesses until
    two models of nearly all key frames agree on the focal lengths; of those found, the one with the most observations
    is returned. Where the focal lengths are known, the first model of most key frames is. Raises `InputError` if no
    start leads to a model of all cameras, or if the models disagree.
    """
    total = sum(len(footage.key_frames(camera)) for camera in range(len(footage.videos)))
    found: list[pycolmap.Reconstruction] = []
    partial: pycolmap.Reconstruction | None = None
    for trial, (start, factor) in enumerate(_starts(footage, best_pairs_across(database, _PAIRS))):
        _guess_focal(footage, database, factor)
        model = _map(footage, database, work / f"trial{trial}", start, total, report)
        if model is None or _worth(footage, model) < ENOUGH:
            if model is not None and (partial is None or model.num_reg_images() > partial.num_reg_images()):
                partial = model
            continue
        report("bundle adjustment", 0, 1)
        adjust(model, refine_focal=not footage.focal_known)
        report("bundle adjustment", 1, 1)
        found.append(model)
        if footage.focal_known or _agree(footage, found):
            break
    usable = [model for model in found if _worth(footage, model) >= ENOUGH]
    if not usable:
        raise InputError(_no_model(footage, partial if not found else found[0]))
    best = max(usable, key=lambda model: (_worth(footage, model) >= _NEARLY_ALL, model.compute_num_observations()))
    others = [model for model in usable if model is not best]
    if others and not footage.focal_known and not any(_same_focal(best, other) for other in others):
        raise InputError(_no_agreement(footage, usable))
    return best


def _starts(footage: Footage, pairs: list[tuple[int, int]]) -> Iterator[tuple[tuple[int, int] | None, float]]:
    """Yield the starts to try: the ids of the first two images, or None to let COLMAP choose them, and the factor by
    which the guessed focal lengths are multiplied."""
    factors = (1.0,) if footage.focal_known else _FOCAL_FACTORS
    for start in (*pairs, None):
        for factor in factors:
            yield start, factor


def _guess_focal(footage: Footage, path: Path, factor: float) -> None:
    with pycolmap.Database.open(path) as database:
        for camera in database.read_all_cameras():
            parameters = np.array(camera.params)
            parameters[camera.focal_length_idxs()] = factor * footage.videos[camera.camera_id - 1].focal
            camera.params = parameters.tolist()
            database.update_camera(camera)


def _agree(footage: Footage, models: list[pycolmap.Reconstruction]) -> bool:
    """Tell whether the last of some models and another have nearly all key frames and the same focal lengths."""
    *others, last = models
    full = [model for model in others if _worth(footage, model) >= _NEARLY_ALL]
    return _worth(footage, last) >= _NEARLY_ALL and any(_same_focal(last, other) for other in full)


def _same_focal(one: pycolmap.Reconstruction, other: pycolmap.Reconstruction) -> bool:
    lengths = [np.array([m.cameras[number].params[0] for number in sorted(m.cameras)]) for m in (one, other)]
    return bool((np.abs(lengths[0] / lengths[1] - 1) < _SAME_FOCAL).all())


def _worth(footage: Footage, model: pycolmap.Reconstruction) -> float:
    """Rate a model: the least share of wanted key frames placed in a camera; 0 for an impossible focal length."""
    shares = []
    for camera, video in enumerate(footage.videos):
        if camera + 1 not in model.cameras:
            return 0.0
        focal = model.cameras[camera + 1].params[0] / max(video.size)
        if not FOCAL_RANGE[0] < focal < FOCAL_RANGE[1]:
            return 0.0
        wanted = footage.wanted_key_frames(camera)
        shares.append(len(set(_placed(model, camera)) & set(wanted)) / len(wanted))
    return min(shares)


def _placed(model: pycolmap.Reconstruction, camera: int) -> list[int]:
    """List the frames of a camera that the model has a pose for."""
    places = [Model.place_of(image) for image in model.images.values() if image.has_pose]
    return sorted(frame for own, frame in places if own == camera)


def _map(
    footage: Footage, database: Path, out: Path, start: tuple[int, int] | None, total: int, report: Report
) -> pycolmap.Reconstruction | None:
    out.mkdir(parents=True)
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed, options.num_threads = footage.seed, THREADS
    options.extract_colors = options.multiple_models = False
    options.min_model_size = 4
    options.min_focal_length_ratio, options.max_focal_length_ratio = FOCAL_RANGE
    options.ba_refine_focal_length = options.mapper.abs_pose_refine_focal_length = False
    options.mapper.init_min_tri_angle = 4.0  # two handheld cameras may stand close together
    if start is not None:
        options.init_image_id1, options.init_image_id2 = start
    done = [2]

    def next_image() -> None:
        done[0] += 1
        report("mapping key frames", min(done[0], total), total)

    models = pycolmap.incremental_mapping(database, out, out, options=options, next_image_callback=next_image)
    return max(models.values(), key=lambda model: model.num_reg_images(), default=None)


def _no_model(footage: Footage, best: pycolmap.Reconstruction | None) -> str:
    names = [f"'{video.name}'" for video in footage.videos]
    placed = {camera: [] if best is None else _placed(best, camera) for camera in range(len(names))}
    if sum(map(len, placed.values())) <= 2:
        return (
            f"cameras {', '.join(names)} cannot be calibrated: no two frames show the same background from places "
            "far enough apart; walk a step or two while filming, or give cameras from a calibration board."
        )
    found = []
    for camera, name in enumerate(names):
        wanted = footage.wanted_key_frames(camera)
        lost = ~np.isin(wanted, placed[camera])
        start, stop = longest_run(lost)
        where = f", none at its frames {wanted[start]} to {wanted[stop - 1]}" if stop - start > 1 else ""
        found.append(f"{name} {int((~lost).sum())} of {len(wanted)}{where}")
    part = advise_keys(footage, placed)
    return (
        f"the cameras cannot be calibrated together: too few key frames could be placed ({'; '.join(found)}); "
        f"{part and f'{part}; otherwise '}more background that both see is needed, videos without cuts and phones that "
        "are not laid down, or more frames: try --key-step 2."
    )


def _no_agreement(footage: Footage, models: list[pycolmap.Reconstruction]) -> str:
    parts = []
    for camera, video in enumerate(footage.videos):
        focal = [model.cameras[camera + 1].params[0] for model in models]
        parts.append(f"'{video.name}' {min(focal):.0f} to {max(focal):.0f}")
    return (
        f"the cameras cannot be told: models that begin with different pictures disagree about the focal lengths "
        f"({', '.join(parts)} pixels); give them with --focal, or film more background that all cameras see."
    )


def adjust(model: pycolmap.Reconstruction, refine_focal: bool = True, rounds: int = 2) -> None:
    """Refine poses, points, focal lengths and the radial distortion of the whole `model`, with Cauchy's loss.

    Observations that stay off are dropped, and so are points seen from one direction only. Without the loss focal
    lengths come out 1 % long.
    """
    scale = max(max(camera.width, camera.height) for camera in model.cameras.values()) / 960
    for _ in range(rounds):
        options = pycolmap.BundleAdjustmentOptions()
        options.print_summary = False
        options.refine_focal_length = refine_focal
        options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
        options.ceres.loss_function_scale = _LOSS_SCALE * scale
        options.ceres.solver_options.num_threads = THREADS
        options.ceres.solver_options.max_num_iterations = 60
        options.ceres.solver_options.function_tolerance = 1e-7
        pycolmap.bundle_adjustment(model, options)
        pycolmap.ObservationManager(model).filter_all_points3D(_LARGEST_RESIDUAL * scale, _SMALLEST_ANGLE)


def median_depth(model: pycolmap.Reconstruction) -> float:
    """Measure the distance to the scene: the median over images of the median depth of the points they see."""
    depths = []
    for image in model.images.values():
        if image.has_pose and image.num_points3D:
            seen = [model.points3D[p.point3D_id].xyz for p in image.points2D if p.has_point3D()]
            pose = image.cam_from_world().matrix()
            depths.append(np.median(np.array(seen) @ pose[2, :3] + pose[2, 3]))
    return float(np.median(depths))


def observations(model: pycolmap.Reconstruction, image_id: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """List what one image sees: pixels (n, 2), ids of the points (n,), and residuals in pixels (n, 2)."""
    image = model.images[image_id]
    seen = [point for point in image.points2D if point.has_point3D()]
    pixels = np.array([point.xy for point in seen]).reshape(-1, 2)
    ids = np.array([point.point3D_id for point in seen], int)
    places = np.array([model.points3D[int(i)].xyz for i in ids]).reshape(-1, 3)
    pose = image.cam_from_world().matrix()
    again = model.cameras[image.camera_id].img_from_cam(places @ pose[:, :3].T + pose[:, 3])
    return pixels, ids, np.reshape(np.asarray(again), (-1, 2)) - pixels
