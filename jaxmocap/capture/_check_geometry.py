"""Checks that need cameras: their paths, and whether keypoints seen through them make a person of human size, who does
not face backwards."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmocap.camera import Cameras, View, project, ranges, triangulate

from ._capture import KEYPOINT_NAMES, Capture
from ._check_calibration import well_placed_frames
from ._config import Finding

_MOST_FRAMES = 12
_CONFIDENT = 0.3
_LARGEST_RESIDUAL = 25.0  # pixels
_FASTEST = 5.0  # metres a second, of a hand or a head, which turns as fast as it likes
_SMALLEST_ANGLE = 8.0  # degrees
_CHAIN = (
    (("neck", "pelvis"),),
    (("r_hip", "r_knee"), ("l_hip", "l_knee")),
    (("r_knee", "r_ankle"), ("l_knee", "l_ankle")),
)
_CHAIN_OF_STATURE = 0.78  # neck to pelvis to knee to ankle, as a part of the height of a standing adult
_FEWEST_AHEAD = 3
_BACKWARDS = -0.5  # of the sum of the lengths


def _largest_motion(poses: Float[np.ndarray, "frame 4 4"]) -> tuple[np.ndarray, np.ndarray]:
    """Metres and degrees between neighbouring frames."""
    rotation = poses[:, :3, :3]
    centres = -np.einsum("tji,tj->ti", rotation, poses[:, :3, 3])
    cosine = (np.einsum("tij,tij->t", rotation[1:], rotation[:-1]) - 1) / 2
    return np.linalg.norm(np.diff(centres, axis=0), axis=1), np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def check_paths(capture: Capture, cameras: Cameras) -> Iterator[Finding]:
    """Tell whether cameras are static or moving, and find jumps that no hand makes.

    Such a jump is a wrong pose of structure from motion.
    """
    poses = np.asarray(cameras.cam_from_world, float)
    for index, name in enumerate(cameras.names):
        metres, degrees = _largest_motion(poses[index])
        if len(metres) == 0 or (metres.max() < 1e-4 and degrees.max() < 0.05):
            yield Finding("note", name, f"{name} is static")
            continue
        centres = -np.einsum("tji,tj->ti", poses[index, :, :3, :3], poses[index, :, :3, 3])
        extent = np.linalg.norm(centres - centres.mean(axis=0), axis=1).max() * 2
        yield Finding("note", name, f"{name} moves within {extent:.2f} m")
        jumps = np.flatnonzero((metres > 0.1 + 8 * np.median(metres)) | (degrees > 5 + 8 * np.median(degrees))) + 1
        sure = well_placed_frames(capture, index)
        numbers = capture.video_frames[index]
        slow = metres * capture.fps < _FASTEST
        fast = [j for j in jumps if slow[j - 1] and int(numbers[j]) in sure and int(numbers[j - 1]) in sure]
        if fast:
            own = numbers[fast]
            yield Finding(
                "note",
                f"{name} frame {ranges([int(f) for f in own])}",
                f"{name} moves by up to {metres[np.array(fast) - 1].max():.2f} m and "
                f"{degrees[np.array(fast) - 1].max():.0f} degrees from one frame to frame "
                f"{ranges([int(f) for f in own])}; the background fits its poses there, so it was quick",
            )
        jumps = np.setdiff1d(jumps, fast)
        if len(jumps):
            own = numbers[jumps]
            yield Finding(
                "warning",
                f"{name} frame {ranges([int(f) for f in own])}",
                f"{name} jumps by up to {metres[jumps - 1].max():.2f} m and {degrees[jumps - 1].max():.0f} degrees at "
                f"frame {ranges([int(f) for f in own])}; its pose there is probably wrong: calibrate again",
            )


def _frames_to_try(capture: Capture, among: Collection[int] | None) -> list[int]:
    """Frames with keypoints in at least two cameras: those `among`, or else the selected ones, or else a few spread
    over the capture."""
    seen = [set(capture.keypoint_frames(index)) for index in range(capture.num_cameras)]
    shared = sorted({frame for a, b in combinations(seen, 2) for frame in a & b})
    chosen = [frame for frame in shared if frame in (capture.selected_frames or ())] or shared
    chosen = chosen if among is None else [frame for frame in shared if frame in among]
    return (
        [chosen[i] for i in sorted({round(x) for x in np.linspace(0, len(chosen) - 1, _MOST_FRAMES)})] if chosen else []
    )


def _stature(points: Float[np.ndarray, "25 3"]) -> float:
    """Height in metres from the lengths of trunk, thigh and shin, whatever the pose; NaN if one is not seen."""
    place = {name: points[index] for index, name in enumerate(KEYPOINT_NAMES)}
    total = 0.0
    for sides in _CHAIN:
        lengths = [float(np.linalg.norm(place[a] - place[b])) for a, b in sides]
        finite = [length for length in lengths if np.isfinite(length)]
        total += float(np.mean(finite)) if finite else np.nan
    return total / _CHAIN_OF_STATURE


def _size_findings(statures: list[float], where: str) -> Iterator[Finding]:
    finite = [value for value in statures if np.isfinite(value)]
    if not finite:
        return
    height = float(np.median(finite))
    found = f"the triangulated keypoints make a person about {height:.3g} m tall"
    if height > 30:
        unit = "millimetres" if height > 400 else "centimetres"
        yield Finding("error", where, f'{found}; the cameras look like {unit}: set units = "{unit}" in capture.toml')
    elif height < 0.1:
        yield Finding("error", where, f"{found}; is units in capture.toml right? The cameras look like another unit")
    elif not 0.8 <= height <= 2.4:
        yield Finding(
            "warning", where, f"{found}; the scale of the cameras is probably wrong: calibrate with a known length"
        )
    else:
        yield Finding("note", where, f"{found}")


def _ahead(points: Float[np.ndarray, "25 3"]) -> Float[np.ndarray, "5"]:
    """Metres by which the nose, the knees and the big toes are ahead of neck, leg and ankle; NaN where unseen.

    Ahead is left x up, so its sign turns with the handedness of the points: of a person these are nearly all positive.
    """
    place: dict[str, np.ndarray] = dict(zip(KEYPOINT_NAMES, points, strict=True))

    def ahead(left: np.ndarray, up: np.ndarray, by: np.ndarray) -> float:
        forward = np.cross(left, up)
        length = np.linalg.norm(forward)
        return float(by @ forward / length) if length > 0 else np.nan

    hips = place["l_hip"] - place["r_hip"]
    shoulders = place["l_shoulder"] - place["r_shoulder"]
    found = [ahead(hips + shoulders, place["neck"] - place["pelvis"], place["nose"] - place["neck"])]
    for side in ("l", "r"):
        hip, knee = place[f"{side}_hip"], place[f"{side}_knee"]
        ankle, toe = place[f"{side}_ankle"], place[f"{side}_big_toe"]
        found += [ahead(hips, hip - ankle, knee - (hip + ankle) / 2), ahead(hips, hip - ankle, toe - ankle)]
    return np.array(found)


def _handedness_findings(people: Iterable[Float[np.ndarray, "25 3"]], trusted: bool) -> Iterator[Finding]:
    """Report when all frames together say that the person is inside out.

    It is an error; a warning where depth is not `trusted`.
    """
    ahead = np.concatenate([_ahead(points) for points in people] or [np.zeros(0)])
    ahead = ahead[np.isfinite(ahead)]
    if len(ahead) >= _FEWEST_AHEAD and ahead.sum() < _BACKWARDS * np.abs(ahead).sum():
        yield Finding(
            "error" if trusted else "warning",
            "cameras",
            "the triangulated keypoints make a person whose knees, feet and nose point backwards: the cameras are "
            "mirrored (an axis of their world is reversed; export them right-handed), or left and right are exchanged "
            "in the keypoints",
        )


@jax.jit
def _triangulate(
    view: View, pixels: Float[Array, "camera 25 2"], weights: Float[Array, "camera 25"]
) -> tuple[Float[Array, "25 3"], Float[Array, "camera 25 2"], Float[Array, "camera 25"]]:
    """Points, their pixels in every camera, and depths."""
    points = triangulate(view, pixels, weights)
    return points, *project(view.intrinsics, view.cam_from_world, points)


def _behind(own: int, names: list[str]) -> Finding:
    return Finding(
        "error",
        f"frame {own}",
        f"the triangulated keypoints of frame {own} lie behind {', '.join(names)}: the cameras are mirrored, or their "
        "files hold world_from_cam where cam_from_world is expected",
    )


def _disagreement(own: int, worst: Float[np.ndarray, " 25"]) -> Finding:
    bad = np.flatnonzero(worst > _LARGEST_RESIDUAL)
    listed = ", ".join(f"{KEYPOINT_NAMES[i]} {worst[i]:.0f} px" for i in bad)
    return Finding(
        "warning",
        f"frame {own}",
        f"the cameras do not agree on keypoints of frame {own}: {listed}; expected below {_LARGEST_RESIDUAL:.0f} px: "
        "wrong detections, another person, another moment (offset), or wrong cameras",
    )


def _points_at(
    capture: Capture, cameras: Cameras, frame: int, findings: list[Finding]
) -> Float[np.ndarray, "25 3"] | None:
    """Triangulate the keypoints of one frame, NaN where unseen or disagreed upon; None if there are none to use."""
    found = [capture.keypoints(index, frame) for index in range(capture.num_cameras)]
    keypoints = np.stack([np.zeros((25, 3)) if points is None else points for points in found])
    weights = np.where(keypoints[..., 2] >= _CONFIDENT, 1.0, 0.0)
    own = int(capture.video_frames[0, frame])
    pixels = keypoints[..., :2]
    points, again, depth = map(np.array, _triangulate(cameras.at(frame), jnp.asarray(pixels), jnp.asarray(weights)))
    usable = np.isfinite(points).all(axis=-1)
    if not usable.any():
        return None
    behind = [name for i, name in enumerate(cameras.names) if weights[i].any() and np.median(depth[i, usable]) <= 0]
    if behind:
        findings.append(_behind(own, behind))
        return None
    residual = np.where((weights > 0) & usable, np.linalg.norm(again - pixels, axis=-1), 0.0)
    worst = residual.max(axis=0)
    if (worst > _LARGEST_RESIDUAL).any():
        findings.append(_disagreement(own, worst))
        points[worst > _LARGEST_RESIDUAL] = np.nan
    return points if np.isfinite(points).any() else None


def triangulated_people(
    capture: Capture, cameras: Cameras, findings: list[Finding], among: Collection[int] | None = None
) -> dict[int, Float[np.ndarray, "25 3"]]:
    """Triangulate the keypoints of some frames: (25, 3) points in metres by frame, NaN where unseen.

    They are `among` those given, or else the selected ones, or a few. What is wrong with frames that cannot be used is
    put into `findings`.
    """
    found = {frame: _points_at(capture, cameras, frame, findings) for frame in _frames_to_try(capture, among)}
    return {frame: points for frame, points in found.items() if points is not None}


def check_subject(capture: Capture, cameras: Cameras, frames: Collection[int]) -> list[Finding]:
    """Triangulate keypoints at `frames`; check residuals, side of the camera, the person's height and handedness."""
    findings: list[Finding] = []
    people = triangulated_people(capture, cameras, findings, frames)
    return [*findings, *check_triangulated(cameras, people)]


def check_triangulated(cameras: Cameras, people: Mapping[int, Float[np.ndarray, "25 3"]]) -> list[Finding]:
    """Check what the triangulated keypoints tell together."""
    angles = []
    for frame, points in people.items():
        rays = np.nanmedian(points, axis=0) - np.asarray(cameras.centres()[:, frame])
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        angles.append(max(float(np.degrees(np.arccos(np.clip(a @ b, -1, 1)))) for a, b in combinations(rays, 2)))
    trusted = min(angles, default=0.0) >= _SMALLEST_ANGLE
    turned = _handedness_findings(list(people.values()), trusted=trusted)
    return [*turned, *_size_findings([_stature(points) for points in people.values()], "cameras")]
