"""Structure from motion of the key frames of all cameras in one model (incremental, Schoenberger and Frahm 2016)."""

from pathlib import Path

import cv2  # noqa: F401  (before pycolmap: the other order crashes)
import numpy as np
import pycolmap

from jaxmocap._results import InputError

from ._footage import Footage
from ._matching import Report, best_pairs_across

_TRIALS = 4  # initial pairs
_ENOUGH = 0.6  # of the key frames of every camera
_FOCAL_RANGE = (0.3, 6.0)  # times the longer side of the image


def map_key_frames(footage: Footage, database: Path, work: Path, report: Report) -> pycolmap.Reconstruction:
    """The model of most key frames: begun with two cameras, far apart, since one hand-held camera alone moves too
    little to tell its focal length. Raises `InputError` when no start leads to a model of all cameras."""
    best: pycolmap.Reconstruction | None = None
    total = sum(len(footage.key_frames(camera)) for camera in range(len(footage.videos)))
    starts: list[tuple[int, int] | None] = [*best_pairs_across(database, _TRIALS), None]
    for trial, start in enumerate(starts):
        found = _map(footage, database, work / f"trial{trial}", start, total, report)
        if found is not None and (best is None or _worth(footage, found) > _worth(footage, best)):
            best = found
        if best is not None and _worth(footage, best) >= 0.9:
            break
    if best is None or _worth(footage, best) < _ENOUGH:
        raise InputError(_no_model(footage, best))
    return best


def _worth(footage: Footage, model: pycolmap.Reconstruction) -> float:
    """The share of registered key frames in the camera that has least; 0 for an impossible focal length."""
    shares = []
    for camera, video in enumerate(footage.videos):
        if camera + 1 not in model.cameras:
            return 0.0
        focal = model.cameras[camera + 1].params[0] / max(video.size)
        if not _FOCAL_RANGE[0] < focal < _FOCAL_RANGE[1]:
            return 0.0
        count = sum(image.has_pose and image.camera_id == camera + 1 for image in model.images.values())
        shares.append(count / len(footage.key_frames(camera)))
    return min(shares)


def _map(
    footage: Footage, database: Path, out: Path, start: tuple[int, int] | None, total: int, report: Report
) -> pycolmap.Reconstruction | None:
    out.mkdir(parents=True)
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed, options.num_threads = footage.seed, footage.threads
    options.extract_colors = options.multiple_models = False
    options.min_model_size = 4
    options.min_focal_length_ratio, options.max_focal_length_ratio = _FOCAL_RANGE
    options.ba_refine_focal_length = options.mapper.abs_pose_refine_focal_length = not footage.focal_known
    options.mapper.init_min_tri_angle = 4.0  # two hand-held cameras may stand close together
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
    counts = np.zeros(len(names), int)
    for image in best.images.values() if best is not None else ():
        counts[image.camera_id - 1] += image.has_pose
    if best is None or counts.sum() <= 2:
        return (
            f"cameras {', '.join(names)} cannot be calibrated: no two frames show the same background from places "
            "far enough apart; walk a step or two while filming, or give cameras from a calibration board."
        )
    found = ", ".join(
        f"{name} {count} of {len(footage.key_frames(camera))}"
        for camera, (name, count) in enumerate(zip(names, counts, strict=True))
    )
    return (
        f"the cameras cannot be calibrated together: too few key frames could be placed ({found}); more background "
        "that both see is needed, videos without cuts, or more frames: try --key-step 2."
    )
