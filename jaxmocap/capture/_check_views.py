"""Where the person is in the cameras' views at all frames: in the picture or not, and how exact depth can be."""

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np
from jaxtyping import Float

from jaxmocap.camera import Cameras, ViewGeometry, look_at_point, ranges, view_geometry

from ._capture import Capture
from ._config import Finding
from ._picture_steps import turns

_WORST_RATIO = 7.5  # of depth to across: two cameras 15 degrees apart
_SMALLEST_PERSON = 0.15  # of the picture's height
_BODY = 1.1  # of what its keypoints span
_FEWEST_SHARED = 0.5  # of the shortest video's frames

People = Mapping[int, Float[np.ndarray, "25 3"]]
"""Triangulated keypoints by frame, NaN where unseen."""


def check_shared_frames(capture: Capture) -> Iterator[Finding]:
    """Check how much of each video all cameras share."""
    if capture.num_cameras < 2:
        return
    counts = [index.num_frames for index in capture.indices]
    parts = ", ".join(
        f"{capture.num_frames / count:.0%} of {index.path.name}"
        for count, index in zip(counts, capture.indices, strict=True)
    )
    seconds = float(capture.timestamps[-1] - capture.timestamps[0])
    found = f"the cameras share {capture.num_frames} frames, {seconds:.2f} s: {parts}"
    if capture.num_frames < _FEWEST_SHARED * min(counts):
        yield Finding(
            "warning",
            "frames",
            f"{found}; most of the footage is lost: is offset in capture.toml right? jaxmocap sync finds it",
        )
    else:
        yield Finding("note", "frames", found)


def check_views(capture: Capture, cameras: Cameras, people: People) -> Iterator[Finding]:
    """Check that the person is in the pictures, and the angles between the cameras with the depth that they allow."""
    if capture.num_cameras < 2:
        return
    poses = np.asarray(cameras.cam_from_world, float)
    focal = np.asarray(cameras.intrinsics, float)[:, 0, 0]
    places = _places(poses, people)
    if places is None:
        return
    yield from _in_picture(capture, cameras, people)
    yield from check_common_size(cameras.turned(turns(cameras.sizes)), people)
    together = [view_geometry(focal, poses[:, frame], place) for frame, place in enumerate(places)]
    for a, b in combinations(range(capture.num_cameras), 2):
        pair = [view_geometry(focal[[a, b]], poses[[a, b], frame], place) for frame, place in enumerate(places)]
        names = f"{cameras.names[a]} and {cameras.names[b]}"
        poor = _ratio(pair) > _WORST_RATIO and capture.num_cameras == 2
        yield _angle_finding(f"{names} see the person from", pair, capture, warn=poor)
    if capture.num_cameras > 2:
        poor = _ratio(together) > _WORST_RATIO
        yield _angle_finding("the outermost of all cameras see the person from", together, capture, warn=poor)


def check_common_size(cameras: Cameras, people: People) -> Iterator[Finding]:
    """Check that the person fits into the part of the pictures that is tracked, which has one size for all views."""
    limit = np.min(np.asarray(cameras.sizes), axis=0)
    for camera, (name, size) in enumerate(zip(cameras.names, np.asarray(cameras.sizes), strict=True)):
        largest = np.zeros(2)
        for frame, points in people.items():
            image = _image(cameras, camera, frame, points)[0]
            spread = (_BODY - 1) / 2 * np.ptp(image, axis=0)
            ends = np.clip([image.min(0) - spread, image.max(0) + spread], 0, size)
            largest = np.maximum(largest, ends[1] - ends[0])
        if (largest > limit).any():
            yield Finding(
                "warning",
                name,
                f"the person takes about {largest[0]:.0f}x{largest[1]:.0f} pixels of {name}'s picture, but only "
                f"{limit[0]}x{limit[1]} of each view are tracked, the least width and height of all pictures: what is "
                "beyond, head and feet perhaps, is guessed; film from farther, or with all cameras held the same way "
                "up",
            )


def _image(
    cameras: Cameras, camera: int, frame: int, points: Float[np.ndarray, "25 3"]
) -> tuple[Float[np.ndarray, "point 2"], Float[np.ndarray, " point"]]:
    """Project the points that are known; pixels and depths."""
    pose = np.asarray(cameras.cam_from_world[camera, frame], float)
    seen = points[np.isfinite(points).all(axis=1)] @ pose[:3, :3].T + pose[:3, 3]
    image = seen @ np.asarray(cameras.intrinsics[camera], float).T
    return image[:, :2] / image[:, 2:], seen[:, 2]


def _ratio(geometries: list[ViewGeometry]) -> float:
    return float(np.median([geometry.ratio for geometry in geometries]))


def _angle_finding(who: str, geometries: list[ViewGeometry], capture: Capture, *, warn: bool) -> Finding:
    angles = [geometry.angle for geometry in geometries]
    worst = int(np.argmax([geometry.ratio for geometry in geometries]))
    across, depth = (float(np.median([getattr(g, name) for g in geometries])) for name in ("across", "depth"))
    least = "" if max(angles) - min(angles) < 0.5 else f" ({min(angles):.0f} to {max(angles):.0f})"
    angle = float(np.median(angles))
    said = f"{who} directions {angle:.{0 if angle >= 10 else 1}f} degrees apart{least}"
    if not np.isfinite(depth):
        return Finding(
            "warning", "cameras", f"{said}: in one line with the person, depth cannot be measured; place them apart"
        )
    said += f": a pixel of error is {100 * across:.1f} cm across and {100 * depth:.1f} cm in depth"
    if not warn:
        return Finding("note", "cameras", said)
    return Finding(
        "warning",
        "cameras",
        f"{said}, {depth / across:.0f} times as much (at worst {geometries[worst].ratio:.0f} times, at frame "
        f"{int(capture.video_frames[0, worst])}; cameras 50 degrees apart have 2.4 times): limbs will be wrong in "
        "depth though every picture looks right; film again with the cameras 20 to 60 degrees apart, or add a third",
    )


def _places(poses: np.ndarray, people: People) -> Float[np.ndarray, "frame 3"] | None:
    """Place the person's middle at every frame: by the keypoints of the frames around, else where cameras look."""
    frames = sorted(people)
    if not frames:
        point = look_at_point(poses.reshape(-1, 4, 4))
        ahead = np.einsum("ctj,j->ct", poses[..., 2, :3], point) + poses[..., 2, 3]
        return np.tile(point, (poses.shape[1], 1)) if (ahead > 0).all() else None
    known = np.array([np.nanmedian(people[frame], axis=0) for frame in frames])
    every = np.arange(poses.shape[1])
    return np.stack([np.interp(every, frames, known[:, axis]) for axis in range(3)], axis=1)


def _in_picture(capture: Capture, cameras: Cameras, people: People) -> Iterator[Finding]:
    """Per camera, at the frames whose keypoints are triangulated: how large the person is, and what is cut off."""
    for camera, name in enumerate(cameras.names):
        width, height = cameras.sizes[camera]
        cut, sizes, inside, total = [], [], 0, 0
        for frame, points in people.items():
            image, depth = _image(cameras, camera, frame, points)
            x, y = image.T
            here = (depth > 0) & (x >= 0) & (x < width) & (y >= 0) & (y < height)
            inside, total = inside + int(here.sum()), total + len(here)
            sizes.append(float(np.ptp(y)) / height)
            if not here.all():
                cut.append(int(capture.video_frames[camera, frame]))
        if not sizes:
            continue
        size = float(np.median(sizes))
        found = f"{name} has {inside / total:.0%} of the person's keypoints in its picture"
        if cut:
            yield Finding(
                "warning",
                name,
                f"{found}, at frame {ranges(cut)} not all of them: what is outside is guessed; film with room around "
                "the person",
            )
        elif size < _SMALLEST_PERSON:
            yield Finding(
                "warning",
                name,
                f"the person is only {size:.0%} of {name}'s picture tall, {size * height:.0f} pixels; film from "
                "nearer, half of the picture or more",
            )
        else:
            yield Finding("note", name, f"{found}, over {size:.0%} of its height")
