"""Static cameras from the person alone: relative poses, bundle adjustment from several starts, and how certain it is.

Two cameras that look at one person tell their focal lengths hardly at all by epipolar geometry, since their axes meet
(Hartley and Zisserman 2004, sec. 19.10): bones that keep their lengths, equal on both sides and of human proportions,
do.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from jaxmocap._results import InputError
from jaxmocap.geometry import align_cameras, camera_residuals

from ._footage import Report
from ._person_adjustment import PersonFit, Rig, adjust_person
from ._person_scene import JOINTS, RIGID, Beliefs, Keypoints, Noise, body_size
from ._relative_pose import relative_poses
from ._static_refusals import FEWEST_FRAMES, FEWEST_JOINTS, listed, refuse_keypoints, refuse_rig, refuse_uncertain

_FACTORS = (1.0, 0.8, 1.25)  # of the focal lengths' guesses, from which the search begins
_TRIED = 2  # relative poses, of two cameras
_MOST_FRAMES, _FEW_FRAMES = 60, 20  # that are adjusted; in the trials
_SIGMA = 0.012  # of a keypoint, of the person's size: 4 pixels where he is 350 tall
_ALIKE = 0.25  # seconds for which a detector errs alike
_SYSTEMATIC = 3.0
"""Deviations are so many times those of independent noise, since a detector sees joints beside themselves in a way that
depends on the side it sees: so they hold in synthetic worlds."""
_SAMPLES = 200


class StaticRig(NamedTuple):
    """What the person tells.

    Attributes:
        rig: the cameras, in about metres.
        points: the joints (`JOINTS`), NaN where fewer than two cameras see one.
        residual: of keypoints, pixels, NaN where there are none.
        centre_deviation: standard deviation of each camera's centre after the best similarity of all cameras.
        angle_deviation: of its orientation, radians.
    """

    rig: Rig
    points: Float[np.ndarray, "frame joint 3"]
    residual: Float[np.ndarray, "camera frame joint"]
    centre_deviation: Float[np.ndarray, " camera"]
    angle_deviation: Float[np.ndarray, " camera"]


def find_static_rig(
    seen: Keypoints,
    centre: Float[np.ndarray, "camera 2"],
    beliefs: Beliefs,
    names: Sequence[str],
    seed: int,
    report: Report,
) -> StaticRig:
    """Find static cameras from keypoints; `centre` are the principal points.

    Raises `InputError`, which says what to film instead, for keypoints that do not tell them.
    """
    frames = usable_frames(seen)
    size = body_size(seen)
    refuse_keypoints(seen, frames, size, names)
    chosen = _spread_out(frames, _MOST_FRAMES)
    best = _best_start(seen, centre, beliefs, size, chosen, names, seed, report)
    report("bundle adjustment", 0, 1)
    part = seen.at(chosen)
    fit = adjust_person(part, centre, best, triangulate(part, best, centre), _noise(part, size), beliefs)
    report("bundle adjustment", 1, 1)
    points = triangulate(seen, fit.rig, centre)
    residual = _residuals(seen, fit.rig, centre, points)
    deviation = _deviations(fit, seed)
    refuse_rig(fit.rig.cam_from_world, points, residual, size, names)
    refuse_uncertain(deviation[1])
    return StaticRig(fit.rig, points, residual, *deviation)


def usable_frames(seen: Keypoints) -> Int[np.ndarray, " frame"]:
    """Find the frames at which two cameras see enough of the person."""
    return np.flatnonzero(seen.together.sum(axis=1) >= FEWEST_JOINTS)


def _spread_out(frames: np.ndarray, most: int) -> np.ndarray:
    return frames[np.unique(np.linspace(0, len(frames) - 1, min(most, len(frames))).round().astype(int))]


def _noise(seen: Keypoints, size: np.ndarray) -> Noise:
    """Frames that follow each other closely count for less."""
    count, span = seen.pixels.shape[1], float(np.ptp(seen.seconds[0]))
    return Noise(_SIGMA * size, min(1.0, max(span / _ALIKE, 6.0) / count))


def _best_start(
    seen: Keypoints,
    centre: np.ndarray,
    beliefs: Beliefs,
    size: np.ndarray,
    chosen: np.ndarray,
    names: Sequence[str],
    seed: int,
    report: Report,
) -> Rig:
    """Adjust a few frames from several focal lengths and relative poses, and take the most probable end."""
    few = seen.at(_spread_out(chosen, _FEW_FRAMES))
    factors = _FACTORS if beliefs.focal_deviation.any() else _FACTORS[:1]
    fits: list[PersonFit] = []
    for number, factor in enumerate(factors):
        report("relative poses", number, len(factors))
        focal = np.where(beliefs.focal_deviation > 0, factor, 1.0) * beliefs.focal
        for rig in _starts(seen.at(chosen), centre, focal, size, names, seed):
            points = triangulate(few, rig, centre)
            if np.isfinite(points).all(-1).sum() < FEWEST_JOINTS * FEWEST_FRAMES // 2:
                continue
            points, rig = _to_human_size(points, rig, beliefs)
            try:
                fits.append(adjust_person(few, centre, rig, points, _noise(few, size), beliefs, 60, 1e-4))
            except RuntimeError:  # a start from which the equations become singular
                continue
    report("relative poses", len(factors), len(factors))
    if not fits:
        raise InputError(
            f"the person's keypoints in {listed(names)} fit no two places of cameras: are these the same person and "
            "the same moments (offset in capture.toml)? jaxmocap sync finds the offsets"
        )
    return min(fits, key=lambda fit: fit.cost).rig


def _starts(
    seen: Keypoints, centre: np.ndarray, focal: np.ndarray, size: np.ndarray, names: Sequence[str], seed: int
) -> Iterator[Rig]:
    """Cameras from the relative poses of one with all others; of two cameras, several such."""
    count = len(focal)
    plane = (seen.pixels - centre[:, None, None]) / focal[:, None, None, None]
    both = np.einsum("afj,bfj->ab", seen.seen.astype(int), seen.seen.astype(int)) * (1 - np.eye(count, dtype=int))
    first = int(both.sum(axis=1).argmax())
    found = {}
    for other in range(count):
        if other == first:
            continue
        at = seen.seen[first] & seen.seen[other]
        if at.sum() < FEWEST_JOINTS * FEWEST_FRAMES:
            raise InputError(
                f"'{names[other]}' and '{names[first]}' see the person together at too few frames to be placed; film "
                "so that both see the whole person at the same time, or leave one camera out"
            )
        sizes = size[first] / focal[first], size[other] / focal[other]
        found[other] = relative_poses(plane[first][at], plane[other][at], sizes, seed)
    for trial in range(_TRIED if count == 2 else 1):
        if any(len(poses) <= trial for poses in found.values()):
            return
        poses = np.tile(np.eye(4), (count, 1, 1))
        depth = None
        for other, several in found.items():
            poses[other] = several[trial].pose
            pair = np.isin(np.arange(count), (first, other))
            alone = seen._replace(seen=seen.seen & pair[:, None, None])
            own = triangulate(alone, Rig(poses, focal, np.zeros(count)), centre)[..., 2]
            if depth is None:
                depth = own
            ratio = depth / own
            ratio = ratio[np.isfinite(ratio) & (ratio > 0)]
            if len(ratio):
                poses[other, :3, 3] *= float(np.median(ratio))
        yield Rig(poses @ np.linalg.inv(poses[0]), focal, np.zeros(count))


def _to_human_size(points: np.ndarray, rig: Rig, beliefs: Beliefs) -> tuple[np.ndarray, Rig]:
    """Scale a start so that the bones have about the lengths they are believed to have."""
    ratios = []
    for name, (length, _) in beliefs.bones.items():
        for a, b in RIGID[name].ends:
            across = np.linalg.norm(points[:, JOINTS.index(a)] - points[:, JOINTS.index(b)], axis=-1)
            if np.isfinite(across).any():
                ratios.append(float(np.nanmedian(across)) / length)
    scale = 1 / float(np.median(ratios)) if ratios else 1.0
    poses = rig.cam_from_world.copy()
    poses[:, :3, 3] *= scale
    return scale * points, rig._replace(cam_from_world=poses)


def triangulate(seen: Keypoints, rig: Rig, centre: Float[np.ndarray, "camera 2"]) -> Float[np.ndarray, "frame joint 3"]:
    """Triangulate all joints by the linear method; NaN where fewer than two cameras see one, behind a camera, and
    beyond ten times the usual distance."""
    poses = rig.cam_from_world
    time = seen.seconds - seen.seconds[:1] + rig.late[:, None]
    pixels = seen.pixels - time[:, :, None, None] * seen.velocity
    plane = (pixels - centre[:, None, None]) / rig.focal[:, None, None, None]
    rows = plane[..., None] * poses[:, None, None, None, 2] - poses[:, None, None, :2]
    rows = np.where(seen.seen[..., None, None], rows, 0.0)
    found = np.linalg.eigh(np.einsum("cfjki,cfjkl->fjil", rows, rows))[1][..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        points = found[..., :3] / found[..., 3:]
    depth = np.einsum("ci,fji->cfj", poses[:, 2, :3], points) + poses[:, 2, 3][:, None, None]
    good = seen.together & (np.where(seen.seen, depth, 1.0) > 0).all(axis=0) & np.isfinite(points).all(-1)
    usual = np.median(depth[:, good]) if good.any() else 1.0
    good &= (depth < 10 * usual).all(axis=0)
    return np.where(good[..., None], points, np.nan)


def _residuals(seen: Keypoints, rig: Rig, centre: np.ndarray, points: np.ndarray) -> np.ndarray:
    poses = rig.cam_from_world
    inside = np.einsum("cik,fjk->cfji", poses[:, :3, :3], points) + poses[:, None, None, :3, 3]
    again = rig.focal[:, None, None, None] * inside[..., :2] / inside[..., 2:] + centre[:, None, None]
    time = seen.seconds - seen.seconds[:1] + rig.late[:, None]
    off = np.linalg.norm(again - (seen.pixels - time[:, :, None, None] * seen.velocity), axis=-1)
    return np.where(seen.seen, off, np.nan)


def _deviations(fit: PersonFit, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Estimate deviations of centres and angles after the best similarity, by samples of the cameras' covariance."""
    generator, count = np.random.default_rng(seed), len(fit.rig.focal)
    symmetric = (fit.covariance + fit.covariance.T) / 2
    values, vectors = np.linalg.eigh(symmetric)
    half = _SYSTEMATIC * vectors * np.sqrt(np.maximum(values, 0.0))
    squares = np.zeros((2, count))
    for _ in range(_SAMPLES):
        twist = np.concatenate([np.zeros(6), half @ generator.normal(size=len(values))]).reshape(count, 6)
        poses = fit.rig.cam_from_world.copy()
        poses[:, :3] = Rotation.from_rotvec(twist[:, :3]).as_matrix() @ poses[:, :3]
        poses[:, :3, 3] += twist[:, 3:]
        similarity = align_cameras(poses, fit.rig.cam_from_world)
        squares += np.square(camera_residuals(similarity, poses, fit.rig.cam_from_world))
    centre, angle = np.sqrt(squares / _SAMPLES)
    return centre, angle
