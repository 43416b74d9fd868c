"""Key frames matched with each other, in the database that COLMAP's mapper reads."""

from itertools import combinations
from pathlib import Path

import cv2  # noqa: F401  (before pycolmap: the other order crashes)
import numpy as np
import pycolmap

from jaxmocap._results import InputError

from ._features import Features, match, read_features
from ._footage import Footage, Report
from ._placeable import advise_keys, longest_run

Place = tuple[int, int]
"""Camera and frame of its own video."""

_WITHIN = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)  # key frames apart, in one camera
_ACROSS = 4  # key frames apart, between two cameras
_FEWEST_FEATURES = 60  # in half of the key frames
FEWEST_SEEN = 25
"""Points without which a frame cannot be placed."""
ENOUGH = 0.6
"""Share of the wanted key frames of every camera that have to be placed."""
_FEWEST_MATCHES = 15
_FEWEST_ACROSS = 30  # verified matches of the best pair between two cameras
_CHUNK = 64


def key_pairs(footage: Footage) -> list[tuple[Place, Place]]:
    """Pair key frames: at growing distances within a camera, and all that are near in time between cameras."""
    keys = [footage.key_frames(camera) for camera in range(len(footage.videos))]
    pairs = []
    for camera, frames in enumerate(keys):
        for step in _WITHIN:
            pairs += [((camera, a), (camera, b)) for a, b in zip(frames, frames[step:], strict=False)]
    for one, other in combinations(range(len(keys)), 2):
        times = np.array([footage.instant(other, frame) for frame in keys[other]])
        for frame in keys[one]:
            nearest = np.argsort(np.abs(times - footage.instant(one, frame)), kind="stable")[: 2 * _ACROSS + 1]
            pairs += [((one, frame), (other, keys[other][int(index)])) for index in sorted(nearest)]
    return pairs


def frame_pairs(footage: Footage, camera: int, frame: int) -> list[Place]:
    """Choose what a frame between the key frames is matched with: the three key frames nearest in time of its own
    camera and one of every other."""
    places = []
    for other in range(len(footage.videos)):
        frames = np.array(footage.key_frames(other))
        away = np.abs(footage.instant(camera, frame) - np.array([footage.instant(other, int(f)) for f in frames]))
        nearest = np.argsort(away, kind="stable")[: 3 if other == camera else 1]
        places += [(other, int(frames[index])) for index in sorted(nearest)]
    return places


def match_key_frames(footage: Footage, path: Path, report: Report) -> dict[Place, Features]:
    """Write cameras, features of key frames and verified matches to the database `path`; return the features by place.

    Raises `InputError` for a video without texture, and for cameras whose views have nothing in common.
    """
    features: dict[Place, Features] = {}
    ids: dict[Place, int] = {}
    total = sum(len(footage.key_frames(camera)) for camera in range(len(footage.videos)))
    with pycolmap.Database.open(path) as database:
        for camera, video in enumerate(footage.videos):
            _write_camera(database, footage, camera)
            for frame, found in read_features(video, footage.key_frames(camera), footage.num_features):
                place = camera, frame
                features[place] = found
                ids[place] = database.write_image(pycolmap.Image(name=video.listed_name(frame), camera_id=camera + 1))
                database.write_keypoints(ids[place], found.points)
                report("features of key frames", len(features), total)
            _refuse_blank(footage, camera, features)
    wanted = key_pairs(footage)
    across = [(one, other) for one, other in wanted if one[0] != other[0]]
    within = [(one, other) for one, other in wanted if one[0] == other[0]]
    done = 0
    for pairs in (across, within):
        matched = []
        with pycolmap.Database.open(path) as database:
            for one, other in pairs:
                matches = match(features[one], features[other])
                if len(matches) >= _FEWEST_MATCHES:
                    database.write_matches(ids[one], ids[other], matches)
                    matched.append((one, other))
                done += 1
                report("matching key frames", done, len(wanted))
        _verify(footage, path, matched, report)
        if pairs is across:
            _refuse_apart(footage, path)  # the rest would not change it
    return features


def best_pairs_across(path: Path, count: int) -> list[tuple[int, int]]:
    """Choose `count` image pairs of different cameras with most verified matches, each image in one of them only."""
    chosen: list[tuple[int, int]] = []
    for inliers, one, other, same in sorted(_verified(path), reverse=True):
        if not same and inliers >= _FEWEST_ACROSS and not {one, other} & {image for pair in chosen for image in pair}:
            chosen.append((one, other))
    return chosen[:count]


def _write_camera(database: pycolmap.Database, footage: Footage, camera: int) -> None:
    video = footage.videos[camera]
    width, height = video.size
    database.write_camera(
        pycolmap.Camera(
            camera_id=camera + 1,
            model="SIMPLE_RADIAL",
            width=width,
            height=height,
            params=[video.focal, width / 2, height / 2, 0.0],
            has_prior_focal_length=video.focal_known,
        ),
        use_camera_id=True,
    )


def _verify(footage: Footage, path: Path, pairs: list[tuple[Place, Place]], report: Report) -> None:
    """Keep the matches that an epipolar geometry explains."""
    names = [tuple(footage.videos[c].listed_name(f) for c, f in pair) for pair in pairs]
    options = pycolmap.TwoViewGeometryOptions()
    options.detect_watermark = False
    options.ransac.max_error = 2.0 * max(max(video.size) for video in footage.videos) / 960
    options.ransac.random_seed = footage.seed
    file = path.with_suffix(".pairs")
    for start in range(0, len(names), _CHUNK):
        file.write_text("".join(f"{a} {b}\n" for a, b in names[start : start + _CHUNK]), encoding="utf-8")
        pycolmap.verify_matches(path, file, options)
        report("verifying matches", min(start + _CHUNK, len(names)), len(names))


def _verified(path: Path) -> list[tuple[int, int, int, bool]]:
    """Count verified matches per pair of images: the count, both image ids, and whether one camera made both."""
    with pycolmap.Database.open(path) as database:
        cameras = {image.image_id: image.camera_id for image in database.read_all_images()}
        pair_ids, counts = database.read_two_view_geometry_num_inliers()
    result = []
    for pair_id, count in zip(np.asarray(pair_ids), np.asarray(counts), strict=True):
        one, other = pycolmap.pair_id_to_image_pair(int(pair_id))
        result.append((int(count), one, other, cameras[one] == cameras[other]))
    return result


def _refuse_blank(footage: Footage, camera: int, features: dict[Place, Features]) -> None:
    video = footage.videos[camera]
    wanted, keys = footage.wanted_key_frames(camera), footage.key_frames(camera)
    counts = {frame: len(features[camera, frame].points) for frame in keys}
    found = np.array([counts[frame] for frame in wanted])
    if np.median(found) >= _FEWEST_FEATURES and np.mean(found >= FEWEST_SEEN) >= ENOUGH:
        return
    start, stop = longest_run(found < _FEWEST_FEATURES)
    where = " outside the person" if video.boxes or video.masks else ""
    part = advise_keys(footage, {camera: [frame for frame in keys if counts[frame] >= _FEWEST_FEATURES]})
    raise InputError(
        f"camera '{video.name}' cannot be calibrated: its frames {wanted[start]} to {wanted[stop - 1]} show only "
        f"{np.median(found[start:stop]):.0f} points that can be recognised{where}, at least {_FEWEST_FEATURES} are "
        f"needed; {part and f'{part}; otherwise '}film where the background has texture and light, leave room around "
        "the person, and do not lay the phone down."
    )


def _refuse_apart(footage: Footage, path: Path) -> None:
    """Raise `InputError` for a camera that shares no background with the first, directly or through others."""
    if len(footage.videos) == 1:
        return
    with pycolmap.Database.open(path) as database:
        cameras = {image.image_id: image.camera_id - 1 for image in database.read_all_images()}
    best: dict[tuple[int, int], int] = {}
    for inliers, one, other, same in _verified(path):
        key = min(cameras[one], cameras[other]), max(cameras[one], cameras[other])
        if not same:
            best[key] = max(best.get(key, 0), inliers)
    reached, grown = {0}, True
    while grown:
        more = {b for pair, count in best.items() if count >= _FEWEST_ACROSS and set(pair) & reached for b in pair}
        grown = not more <= reached
        reached |= more
    for camera, video in enumerate(footage.videos):
        if camera not in reached:
            most = max((count for pair, count in best.items() if camera in pair), default=0)
            raise InputError(
                f"camera '{video.name}' shares no background with the others: the best pair of frames has {most} "
                f"points in common, at least {_FEWEST_ACROSS} are needed; film the same place from directions less far "
                "apart (20 to 60 degrees), or calibrate with --key-step 2 if the cameras cross only for a moment."
            )
