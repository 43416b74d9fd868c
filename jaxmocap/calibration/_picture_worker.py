"""In the child process: structure from motion of single pictures of one camera, by COLMAP from end to end."""

import json
from collections.abc import Iterator
from pathlib import Path

import cv2  # noqa: F401  (before pycolmap: the other order crashes)
import numpy as np
import pycolmap

from jaxmocap._results import InputError

from ._footage import Report
from ._mapping import FOCAL_RANGE, THREADS, adjust

NEIGHBOURS = 8
"""Pictures to either side, round the lap, that a picture of an ordered lap is matched with."""

_FEWEST_FEATURES = 100


def map_pictures(folder: Path, report: Report) -> None:
    """Write `model`, a COLMAP model of what `pictures` show, as `job.json` says; all of it, for nothing moves.

    Raises `InputError` where the pictures show too little, or nothing in common.
    """
    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    names, database, pictures = job["names"], folder / "database.db", folder / "pictures"
    _extract(job, database, pictures, report)
    pairs = list(_pairs(len(names), job["in_order"]))
    (folder / "pairs.txt").write_text("".join(f"{names[a]} {names[b]}\n" for a, b in pairs), encoding="utf-8")
    report("matching pictures", 0, 1)
    matching, verifying = pycolmap.FeatureMatchingOptions(), pycolmap.TwoViewGeometryOptions()
    matching.num_threads, matching.use_gpu = job["threads"], False
    verifying.ransac.random_seed = job["seed"]
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = folder / "pairs.txt"
    pycolmap.match_image_pairs(database, matching, pairing, verifying, device=pycolmap.Device.cpu)
    report("matching pictures", 1, 1)
    model = _map(job, database, folder, report)
    if model is None or model.num_reg_images() < max(6, len(names) // 2):
        placed = 0 if model is None else model.num_reg_images()
        raise InputError(
            f"of {len(names)} pictures {placed} could be placed: too little of what they show is seen in the next one "
            "too; walk slowly and once all around, where ground and background have texture and light, or give "
            "--cameras."
        )
    report("bundle adjustment", 0, 1)
    adjust(model, refine_focal=job["focal"] is None)
    report("bundle adjustment", 1, 1)
    (folder / "model").mkdir()
    model.write_text(folder / "model")
    placed = sorted(image.name for image in model.images.values() if image.has_pose)
    (folder / "placed.json").write_text(json.dumps(placed), encoding="utf-8")


def _extract(job: dict, database: Path, pictures: Path, report: Report) -> None:
    report("features of pictures", 0, 1)
    reading, extraction = pycolmap.ImageReaderOptions(), pycolmap.FeatureExtractionOptions()
    reading.camera_model = "SIMPLE_RADIAL"
    extraction.num_threads, extraction.use_gpu = job["threads"], False
    extraction.sift.max_num_features = job["num_features"]
    width, height = job["size"]
    focal = job["guess"] if job["focal"] is None else job["focal"]
    reading.camera_params = f"{focal},{width / 2},{height / 2},0"
    pycolmap.extract_features(
        database,
        pictures,
        image_names=job["names"],
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=reading,
        extraction_options=extraction,
        device=pycolmap.Device.cpu,
    )
    with pycolmap.Database.open(database) as opened:
        counts = [opened.num_keypoints_for_image(image.image_id) for image in opened.read_all_images()]
    if not counts or np.median(counts) < _FEWEST_FEATURES:
        found = int(np.median(counts)) if counts else 0
        raise InputError(
            f"the pictures show only {found} points that can be recognised, at least {_FEWEST_FEATURES} are needed: "
            "they are too dark or blurred, or the place has no texture; film where there is light, and walk slowly."
        )
    report("features of pictures", 1, 1)


def _pairs(count: int, in_order: bool) -> Iterator[tuple[int, int]]:
    """Pair neighbours round the lap, or all with all."""
    reach = min(NEIGHBOURS, count // 2) if in_order else count
    for one in range(count):
        for other in range(one + 1, count):
            if min(other - one, count - (other - one)) <= reach:
                yield one, other


def _map(job: dict, database: Path, folder: Path, report: Report) -> pycolmap.Reconstruction | None:
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed, options.num_threads = job["seed"], THREADS
    options.extract_colors = options.multiple_models = False
    options.min_focal_length_ratio, options.max_focal_length_ratio = FOCAL_RANGE
    options.ba_refine_focal_length = options.mapper.abs_pose_refine_focal_length = job["focal"] is None
    done, total = [2], len(job["names"])

    def next_image() -> None:
        done[0] += 1
        report("placing pictures", min(done[0], total), total)

    (folder / "mapped").mkdir()
    models = pycolmap.incremental_mapping(
        database, folder / "pictures", folder / "mapped", options=options, next_image_callback=next_image
    )
    return max(models.values(), key=lambda model: model.num_reg_images(), default=None)
