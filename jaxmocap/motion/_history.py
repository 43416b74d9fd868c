"""How the person has moved up to a frame, and where that leads: the autoregression of Eq. 10."""

from typing import Literal, NamedTuple, get_args

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from jaxmocap._results import InputError
from jaxmocap.character import (
    ROOT_DOFS,
    Pose,
    Skeleton,
    away_from_limits,
    difference,
    nearest_equivalent,
    rewritten_increments,
)

from ._frame_times import SHORTEST_STEP, frames_apart

Order = Literal["ridge", "quadratic", "velocity"]
MINIMUM_FOR_RIDGE = 7  # differences, that is eight poses


def predict_difference(
    differences: Float[Array, "frame dof"],
    count: int | Int[Array, ""] | None = None,
    mode: Order = "ridge",
    ridge: ArrayLike = 0.1,
) -> Float[Array, "dof"]:
    """Predict the next difference `chi^_t - chi_{t-1}` from past ones `d_k = chi_k - chi_{k-1}`, oldest first.

    The paper says "linear 3rd order" and names no coefficients. On poses `chi^_t = a1 chi_{t-1} + a2 chi_{t-2} + a3
    chi_{t-3}`; here a1 + a2 + a3 = 1, so that the choice of a zero angle does not matter and the root can be predicted
    in its tangent space (differences are then rotation and translation increments). On differences this is `d^ = b1
    d_{t-1} + b2 d_{t-2}`:

    - `"velocity"`: a = (2, -1, 0), b = (1, 0).
    - `"quadratic"`: a = (3, -3, 1), b = (2, -1), constant acceleration; amplifies noise most.
    - `"ridge"`: b per degree of freedom by least squares over the given frames, with `ridge` times the mean square
      difference pulling towards (1, 0). Below eight poses it is `"velocity"`.

    `count` says how many of the last rows are valid (default all), so that a window of fixed length compiles once; 30
    poses are a good window. With one difference every mode is `"velocity"`; with none the prediction is zero.
    """
    if mode not in get_args(Order):
        raise InputError(f"The autoregression mode is {mode!r}, expected one of {', '.join(get_args(Order))}.")
    rows = differences.shape[0]
    count = jnp.minimum(rows if count is None else count, rows)
    valid = jnp.arange(rows)[:, None] >= rows - count
    padding = jnp.zeros((2, differences.shape[1]), differences.dtype)
    known = jnp.concatenate([padding, jnp.where(valid, differences, 0.0)])
    last, before = known[-1], known[-2]
    if mode == "velocity":
        return last
    if mode == "quadratic":
        return jnp.where(count >= 2, 2 * last - before, last)
    fitted = _fit(known, count, jnp.asarray(ridge))
    return jnp.where(count >= MINIMUM_FOR_RIDGE, fitted[0] * last + fitted[1] * before, last)


def _fit(
    known: Float[Array, "padded dof"], count: Int[Array, ""], ridge: Float[Array, ""]
) -> tuple[Float[Array, "dof"], Float[Array, "dof"]]:
    """Ridge regression of each difference on its two predecessors; two unknowns, so Cramer's rule."""
    usable = (jnp.arange(known.shape[0] - 2)[:, None] >= known.shape[0] - count).astype(known.dtype)
    square = jnp.sum(known**2, axis=0) / jnp.maximum(count, 1)
    known = known / jnp.sqrt(jnp.where(square > 0, square, 1.0))  # a root of zero would make the gradient NaN
    target, first, second = usable * known[2:], usable * known[1:-1], usable * known[:-2]
    pull = jnp.maximum(ridge, 1e-6)
    aa, bb, ab = jnp.sum(first**2, 0) + pull, jnp.sum(second**2, 0) + pull, jnp.sum(first * second, 0)
    ya, yb = jnp.sum(target * first, 0) + pull, jnp.sum(target * second, 0)
    determinant = aa * bb - ab**2
    return (ya * bb - yb * ab) / determinant, (yb * aa - ya * ab) / determinant


AngleChoice = Literal["same", "away_from_limits"]
"""Whether a ball joint keeps its set of angles from frame to frame, or takes the one with more room."""

WINDOW = 30
"""Increments that the autoregression sees."""


LONGEST_PREDICTION = 0.25
"""Seconds after which nobody goes on as before."""


class MotionHistory(NamedTuple):
    """How the person has moved up to the last tracked frame.

    Attributes:
        timestamp: of that frame, seconds.
        pose: in it.
        increments: that led to it, oldest first, each over one usual interval between frames. A gap of several
            intervals, where frames are missing or were passed over, counts as so many equal ones.
        interval: the usual one, seconds; 0 where it is not known, and every frame then counts as one step.
    """

    timestamp: float
    pose: Pose
    increments: tuple[Float[np.ndarray, "dof"], ...] = ()
    interval: float = 0.0

    def steps(self, timestamp: float) -> float:
        """Tell how many usual intervals a frame lies after the last one, or before it where tracking runs backwards."""
        if self.interval <= 0:
            return 1.0
        return max(float(frames_apart(np.array(timestamp - self.timestamp), self.interval)), SHORTEST_STEP)

    def foreseen(self, timestamp: float) -> float:
        """Tell over how many of these steps motion is predicted: no longer than `LONGEST_PREDICTION`, or one."""
        most = max(LONGEST_PREDICTION / self.interval, 1.0) if self.interval > 0 else 1.0
        return min(self.steps(timestamp), most)

    def predicted(self, mode: Order, timestamp: float) -> Float[np.ndarray, "dof"]:
        """Predict the increment to a frame by the autoregression of Eq. 10, step by step if it is several away."""
        num_dofs = ROOT_DOFS + self.pose.angles.shape[0]
        if not self.increments:
            return np.zeros(num_dofs)
        window, ahead = [*self.increments], np.zeros(num_dofs, np.float32)
        left = self.foreseen(timestamp)
        while left > 0:
            known = np.zeros((WINDOW, num_dofs), np.float32)
            known[-len(window) :] = np.stack(window)
            step = np.asarray(predict_difference(jnp.asarray(known), len(window), mode))
            ahead, left = ahead + min(left, 1.0) * step, left - 1.0
            window = [*window, step][-WINDOW:]
        return ahead

    def pace(self, fps: float) -> float:
        """Measure the speed of the fastest joint in metres per second at 0.4 m from its axis.

        It is held between 0.5 and 2; 1 when nothing is known.
        """
        if not self.increments:
            return 1.0
        return float(np.clip(np.abs(self.increments[-1][ROOT_DOFS:]).max() * 0.4 * max(fps, 1e-3), 0.5, 2.0))


def after(
    skeleton: Skeleton,
    history: MotionHistory | None,
    timestamp: float,
    pose: Pose,
    angles: AngleChoice,
    interval: float = 0.0,
) -> MotionHistory:
    """Return the history of the frame that follows one with this pose; `interval` counts where there was none."""
    increments: tuple[np.ndarray, ...] = ()
    written = away_from_limits(skeleton, pose) if angles == "away_from_limits" else pose
    if history is not None:
        before = nearest_equivalent(skeleton, history.pose, pose) if angles == "away_from_limits" else history.pose
        steps, interval = history.steps(timestamp), history.interval
        step = np.asarray(difference(skeleton, before, pose)) / steps
        known = rewritten_increments(skeleton, history.pose, before, history.increments)
        known = rewritten_increments(skeleton, pose, written, [*known, *[step] * max(round(steps), 1)])
        increments = tuple(known[-WINDOW:])
    return MotionHistory(timestamp, written, increments, interval)
