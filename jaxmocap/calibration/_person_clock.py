"""When each video began, to a fraction of a frame: rays of calibrated cameras to the person meet at one time only.

Sound and motion of the pictures are good to about a frame. Cameras that move are found by the background alone,
whenever they filmed it, so that a joint that they see at the same moment lies on its epipolar line, and one that moved
meanwhile does not.
"""

import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import least_squares

from jaxmocap.capture import KEYPOINT_NAMES, Capture, Undistortion
from jaxmocap.geometry import camera_centres

from ._child import Solved
from ._footage import CONFIDENT
from ._person_scene import JOINTS

_ROWS = np.array([KEYPOINT_NAMES.index(name) for name in JOINTS])
_REACH = 0.2  # seconds: as much as phones' sound comes late
_STEP = 0.5  # frames, of the first look
_SLOPE = 0.05  # frames, over which slopes are taken: the window moves on by whole frames
_MOST_FRAMES = 300  # that are looked at: of longer clips every so many
_FEWEST_ROWS = 150
_WINDOW = 4  # frames on either side, of a Gaussian of one frame
_ENOUGH = 1.25  # of its weights, which add up to 2.5
_BLOCKS = 8  # of the clip, left out in turn: a detector errs alike for a while
_BLURRED = 0.25  # frames: with a standard deviation of more nothing is known better than by sound
_LEAST_SIGMA = 0.3  # pixels
_MAD_TO_SIGMA = 1.4826


class PersonClock(NamedTuple):
    """How much later than their offsets say cameras filmed the person.

    Attributes:
        late: seconds, 0 for the first camera.
        deviation: standard deviation, seconds; 0 for the first camera.
        before: median distance from epipolar lines with the offsets as they are, pixels.
        after: the same with them moved.
    """

    late: Float[np.ndarray, " camera"]
    deviation: Float[np.ndarray, " camera"]
    before: float
    after: float

    def known(self, frame: float) -> Float[np.ndarray, " camera"]:
        """Take what is known to a quarter of a frame, 0 elsewhere; `frame` and what is returned are seconds."""
        return np.where(self.deviation < _BLURRED * frame, self.late, 0.0)

    def record(self, capture: Capture) -> dict[str, Any]:
        """Write down what was found, per camera of the `capture`, and whether offsets are moved by it."""
        known = self.known(1 / capture.fps)
        cameras = {
            name: {"late_seconds": round(float(late), 5), "deviation_seconds": round(float(deviation), 5)}
            for name, late, deviation in zip(capture.camera_names, self.late, self.deviation, strict=True)
        }
        residual = [round(self.before, 3), round(self.after, 3)]
        return {"cameras": cameras, "residual_pixels": residual, "moved": bool(known.any())}


_Distances = Callable[[np.ndarray], np.ndarray]
"""From moments of all cameras but the first, frames, to pixels by pair of cameras, moment and joint; NaN: not seen."""


class _Rays(NamedTuple):
    """A camera's centres, and directions to joints, at its frames: in the world, which moves smoothly where pixels of a
    shaken camera do not; NaN where a joint is not seen."""

    seconds: Float[np.ndarray, " frame"]
    centres: Float[np.ndarray, "frame 3"]
    directions: Float[np.ndarray, "frame joint 3"]

    def at(
        self, seconds: Float[np.ndarray, " time"]
    ) -> tuple[Float[np.ndarray, "time 3"], Float[np.ndarray, "time joint 3"]]:
        """Smooth over some frames about a moment: local straight lines under a Gaussian; NaN where too few see a joint.

        That is as noisy between frames as on them. Interpolation is less noisy there, which would draw moments there.
        """
        own = self.seconds
        position = np.interp(seconds, own, np.arange(len(own)), np.nan, np.nan)
        inside = np.isfinite(position)
        near = np.round(np.where(inside, position, 0))[:, None].astype(int) + np.arange(-_WINDOW, _WINDOW + 1)
        frames = np.clip(near, 0, len(own) - 1)
        away = near - position[:, None]
        weights = np.where(inside[:, None] & (near == frames), np.exp(-0.5 * away**2), 0.0)
        return (
            _straight(weights, away, self.centres[frames][:, :, None])[:, 0],
            _straight(weights, away, self.directions[frames]),
        )


def _straight(
    weights: Float[np.ndarray, "time near"],
    away: Float[np.ndarray, "time near"],
    values: Float[np.ndarray, "time near point 3"],
) -> Float[np.ndarray, "time point 3"]:
    """Fit straight lines through values that are `away` from where they are wanted; NaN where too little is known."""
    seen = np.where(np.isfinite(values[..., 0]), weights[..., None], 0.0)
    by = np.where(seen > 0, away[..., None], 0.0)
    total, first, second = (np.sum(seen * by**power, axis=1) for power in range(3))
    apart = total * second - first**2
    known = (total > _ENOUGH) & (apart > 1e-3)
    shares = seen * (second[:, None] - first[:, None] * by) / np.where(known, apart, 1.0)[:, None]
    found = np.einsum("tnp,tnpi->tpi", shares, np.nan_to_num(values))
    return np.where(known[..., None], found, np.nan)


def person_clock(capture: Capture, solved: Solved) -> PersonClock | None:
    """Find how much later than their offsets say cameras filmed the person, from keypoints at many frames.

    Robust least squares (Cauchy's loss) of the distances between joints and their epipolar lines over the moments of
    all cameras but the first, begun at the best of a grid; deviations by leaving out parts of the clip in turn
    (jackknife). `capture` is as recorded, `solved` in any units. None where too little is seen in two views, or the
    best lies at the end of what was looked at.
    """
    rays = [_rays(capture, solved, camera) for camera in range(capture.num_cameras)]
    frame, focal = 1 / capture.fps, float(solved.intrinsics[:, 0, 0].mean())
    times = rays[0].seconds[:: -(-capture.num_frames // _MOST_FRAMES)]

    @functools.lru_cache(maxsize=4 * len(rays))  # one camera moves at a time
    def placed(camera: int, frames: float) -> tuple[np.ndarray, np.ndarray]:
        return rays[camera].at(times - frames * frame)

    def distances(frames: Float[np.ndarray, " other"]) -> Float[np.ndarray, "pair time joint"]:
        return focal * _distances([placed(camera, late) for camera, late in enumerate((0.0, *frames.tolist()))])

    before = distances(np.zeros(capture.num_cameras - 1))
    if np.isfinite(before).sum() < _FEWEST_ROWS:
        return None
    blocks = np.arange(len(times)) * _BLOCKS // len(times)
    starts = _starts(distances, capture.num_cameras - 1, _REACH / frame, _spread(before), blocks)
    found = _solve(distances, starts[0])
    if (np.abs(found) > _REACH / frame).any():
        return None
    after = distances(found)
    without = [
        _solve(lambda x, kept=blocks != block: distances(x)[:, kept], start, (_spread(after),))
        for block, start in enumerate(starts[1:])
    ]
    spread = np.sqrt((_BLOCKS - 1) * np.mean((np.array(without) - found) ** 2, axis=0))
    late, deviation = (np.concatenate([[0.0], values]) * frame for values in (found, spread))
    return PersonClock(late, deviation, *(float(np.nanmedian(np.abs(d))) for d in (before, after)))


def _rays(capture: Capture, solved: Solved, camera: int) -> _Rays:
    matrix, index = solved.intrinsics[camera], capture.indices[camera]
    lens, inverse = Undistortion(matrix, solved.distortion[camera], capture.sizes[camera]), np.linalg.inv(matrix)
    own, positions = np.unique(capture.video_frames[camera], return_index=True)  # a slower video shows some twice
    poses = solved.shared_poses()[camera, positions]
    directions = np.full((len(own), len(_ROWS), 3), np.nan)
    for rays, pose, position in zip(directions, poses, positions.tolist(), strict=True):
        person = capture.keypoints(camera, position)
        seen = np.zeros(len(_ROWS), bool) if person is None else person[_ROWS, 2] >= CONFIDENT
        if person is None or not seen.any():
            continue
        pixels = lens.points(person[_ROWS[seen], :2])
        world = np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1) @ inverse.T @ pose[:3, :3]
        rays[seen] = world / np.linalg.norm(world, axis=1, keepdims=True)
    return _Rays(index.seconds[own] + capture.offsets[camera], camera_centres(poses), directions)


def _distances(
    placed: Sequence[tuple[Float[np.ndarray, "time 3"], Float[np.ndarray, "time joint 3"]]],
) -> Float[np.ndarray, "pair time joint"]:
    """Measure Sampson's distances of rays of every two cameras, in focal lengths; NaN where a joint is not seen."""
    found = []
    for (first, left), (second, right) in itertools.combinations(placed, 2):
        base = np.broadcast_to((second - first)[:, None], left.shape)
        planes = np.stack([np.cross(base, left), np.cross(base, right)])
        apart = np.einsum("tji,tji->tj", base, np.cross(left, right))
        found.append(apart / np.sqrt((planes**2).sum(axis=(0, -1))))
    return np.stack(found)


def _spread(distances: Float[np.ndarray, "pair time joint"]) -> float:
    return max(_MAD_TO_SIGMA * float(np.nanmedian(np.abs(distances))), _LEAST_SIGMA)


def _starts(
    distances: _Distances, count: int, reach: float, sigma: float, blocks: Int[np.ndarray, " time"]
) -> list[Float[np.ndarray, " other"]]:
    """Try moments of one camera after the other: the best of a grid, for all blocks and without each in turn.

    The mean loss counts, for fewer frames are shared at some moments than at others; half of the rows have to be.
    """
    grid = np.arange(-np.floor(reach / _STEP), np.floor(reach / _STEP) + 1) * _STEP
    starts = np.zeros((_BLOCKS + 1, count))
    left_out = np.arange(_BLOCKS) == np.arange(-1, _BLOCKS)[:, None]
    for camera in range(count):
        sums, rows = np.zeros((2, len(grid), _BLOCKS))
        for number, moment in enumerate(grid):
            losses = np.log1p((distances(np.where(np.arange(count) == camera, moment, starts[0])) / sigma) ** 2)
            sums[number] = [np.nansum(losses[:, blocks == block]) for block in range(_BLOCKS)]
            rows[number] = [(~np.isnan(losses[:, blocks == block])).sum() for block in range(_BLOCKS)]
        total, used = sums @ ~left_out.T, rows @ ~left_out.T
        means = np.where(used >= used.max(axis=0) / 2, total / np.maximum(used, 1), np.inf)
        starts[:, camera] = grid[np.argmin(means, axis=0)]
    return list(starts)


def _solve(
    distances: _Distances, start: Float[np.ndarray, " other"], sigmas: Sequence[float | None] = (None, None)
) -> Float[np.ndarray, " other"]:
    """Find the moments of least loss, once per scale of the distances; None takes it from where the last one ended."""
    found = start
    for sigma in sigmas:
        rows = distances(found)
        kept, scale = ~np.isnan(rows), _spread(rows) if sigma is None else sigma

        def residuals(x: np.ndarray, kept: np.ndarray = kept) -> np.ndarray:
            return np.nan_to_num(distances(x))[kept]

        def slopes(x: np.ndarray, residuals: _Distances = residuals) -> np.ndarray:
            steps = _SLOPE * np.eye(len(x))
            return np.stack([residuals(x + step) - residuals(x - step) for step in steps], axis=1) / (2 * _SLOPE)

        jacobian: Any = slopes  # whose type scipy states too narrowly
        found = least_squares(residuals, found, jacobian, loss="cauchy", f_scale=scale, max_nfev=40).x
    return found
