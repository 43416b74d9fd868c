"""Where the objectives want to be, and where the truth is: the ruler for every change of an energy.

    python benchmarks/landscape.py ../shared/data/plaza --frames 50:100 [--curves] [--out FIGURES.json]

In every frame the pose that fits the truth best (joints and markers, least squares over all degrees of freedom) is put
beside the pose that was found, and refined from there. Where the found pose is clearly worse than the refined best fit,
the search has ended where its objective wants: for these frames the table says how often each objective prefers the
right pose, and how the two differ in the median. `--curves` moves the best fit along every degree of freedom and says
where the least of each term lies: with `--frames 0:100` on captures that no energy was chosen by.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import jaxmocap

jaxmocap.configure()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
import optimistix  # noqa: E402
from figures import Figure, add_options, finish, record  # noqa: E402
from rich.progress import track as progress  # noqa: E402

from jaxmocap.capture import Capture  # noqa: E402
from jaxmocap.character import Pose, clamp, landmark_positions, retract, skin  # noqa: E402
from jaxmocap.metrics import COMPARABLE, Truth, nearest_on_surface  # noqa: E402
from jaxmocap.motion import Motion, MotionHistory  # noqa: E402
from jaxmocap.observation import Frame, Observations, observe  # noqa: E402
from jaxmocap.pipeline import open_character, register_and_learn  # noqa: E402
from jaxmocap.refinement import sum_of_squares  # noqa: E402
from jaxmocap.track import FrameTracker, Tracker, TrackingState, with_settings  # noqa: E402

WORSE = 0.003
"""Metres by which a found pose's joints are farther off than the refined best fit's, to be called clearly worse."""

OFFSETS = np.radians([-32, -16, -8, -4, -2, 0, 2, 4, 8, 16, 32])
"""Angles by which `--curves` moves a degree of freedom."""


class BestFit:
    """Fits poses to the true joints and markers of a capture's frames.

    Markers keep their places on the skin as the paper's protocol says: where they are nearest in the first frame.
    """

    def __init__(self, observations: Observations):
        capture, character = observations.capture, observations.character
        self.character = character
        start = observations.key_poses[min(observations.key_poses)]
        still = Motion.from_poses(
            character,
            jax.tree.map(lambda x: jnp.broadcast_to(x, (capture.num_frames, *x.shape)), start),
            capture.video_frames[0],
            capture.timestamps,
        )
        self.truth, _ = Truth.read(capture.truth).at(still)
        names = character.skeleton.landmark_names
        wanted = names if self.truth.has_our_joints else COMPARABLE
        pairs = [(names.index(n), k) for k, n in enumerate(self.truth.joint_names) if n in wanted and n in names]
        self.ours, self.theirs = np.array(pairs).T
        self.attached = (np.zeros((0, 3), int), np.zeros((0, 3)), np.zeros(0, int))
        if self.truth.markers is not None:
            pose, markers = self(0, start), self.truth.markers[0]
            seen = np.flatnonzero(np.isfinite(markers).all(-1))
            faces = np.asarray(character.faces)
            face, barycentric = nearest_on_surface(markers[seen], np.asarray(skin(character, pose)), faces)
            self.attached = (faces[face], barycentric, seen)

    def __call__(self, frame: int, start: Pose) -> Pose:
        """Fit one frame, from a pose near to it."""
        corners, barycentric, which = self.attached
        targets = self.truth.joints[frame, self.theirs]
        if len(which):
            targets = np.concatenate([targets, self.truth.markers[frame, which]])
        known = np.isfinite(targets).all(-1, keepdims=True)
        values = jnp.asarray(np.where(known, targets, 0.0), jnp.float32), jnp.asarray(known, jnp.float32)
        tables = (jnp.asarray(self.ours), jnp.asarray(corners), jnp.asarray(barycentric, jnp.float32))
        return _fitted(self.character, start, *values, *tables)

    def errors(self, frame: int, pose: Pose) -> np.ndarray:
        """Distances of the joints from the truth, metres."""
        found = np.asarray(landmark_positions(self.character.skeleton, pose))[self.ours]
        return np.linalg.norm(found - self.truth.joints[frame, self.theirs], axis=-1)


@jax.jit
def _fitted(character, start, targets, known, joints, corners, barycentric):
    def residual(delta, _):
        pose = retract(character.skeleton, start, delta)
        points = landmark_positions(character.skeleton, pose)[joints]
        if corners.shape[0]:
            on_skin = jnp.einsum("mk,mkc->mc", barycentric, skin(character, pose)[corners])
            points = jnp.concatenate([points, on_skin])
        beyond = jnp.maximum(pose.angles - character.skeleton.upper, 0) + jnp.maximum(
            character.skeleton.lower - pose.angles, 0
        )
        return jnp.concatenate([((points - targets) * known).reshape(-1), 3e-3 * delta, beyond])

    solver = optimistix.LevenbergMarquardt(rtol=1e-5, atol=1e-6)
    still = jnp.zeros(character.skeleton.num_dofs)
    found = optimistix.least_squares(residual, solver, still, max_steps=60, throw=False)
    return clamp(character.skeleton, retract(character.skeleton, start, found.value))


class Compared(NamedTuple):
    """A frame's poses (found, best fit, best fit refined): joint errors in metres and the objectives of each."""

    frame: int
    errors: np.ndarray
    objectives: dict[str, np.ndarray]


class Landscape:
    """Tracks a capture and compares every frame's poses."""

    def __init__(self, observations: Observations, tracker: Tracker, key: jax.Array):
        self.worker = FrameTracker(observations, tracker, key)
        self.best = BestFit(observations)
        self.terms = [term.name for term in tracker.scored.terms]

    def compare(self, frame: Frame, history: MotionHistory | None, found: Pose) -> Compared:
        """Compare the poses of a tracked frame."""
        refinement = self.worker.refinement
        assert refinement is not None
        right = self.best(frame.number, found)
        poses = [found, right, refinement(frame, right, history)[0]]
        totals, terms = self.worker.score(frame.problem, poses)
        objectives = {"eq. 5": totals} | {name: terms[:, k] for k, name in enumerate(self.terms)}
        objectives["data cost"] = np.array([self.data_cost(frame, pose) for pose in poses])
        errors = np.array([self.best.errors(frame.number, pose).mean() for pose in poses])
        return Compared(frame.number, errors, objectives)

    def data_cost(self, frame: Frame, pose: Pose) -> float:
        """The refinement's robust rows per unit of their weight: how the pictures disagree with a pose."""
        assert self.worker.refinement is not None
        rows = self.worker.refinement.rows(frame, pose)
        still = jnp.zeros(self.worker.character.skeleton.num_dofs)
        weight = sum(float(row.lines.weight.sum()) for row in rows)
        return float(sum_of_squares(self.worker.character, pose, still, rows, ())) / max(weight, 1e-9)

    def curves(self, frame: Frame, start: Pose) -> dict[str, np.ndarray]:
        """Of every term the angle (degrees) at which it is least, per degree of freedom, from the best fit."""
        skeleton = self.worker.character.skeleton
        right = self.best(frame.number, start)
        least: dict[str, list[float]] = {name: [] for name in ("eq. 5", *self.terms)}
        for dof in range(6, skeleton.num_dofs):
            moved = [retract(skeleton, right, jnp.zeros(skeleton.num_dofs).at[dof].set(angle)) for angle in OFFSETS]
            totals, terms = self.worker.score(frame.problem, moved)
            for name, values in zip(least, (totals, *terms.T), strict=True):
                least[name].append(float(np.degrees(OFFSETS[int(np.argmin(values))])))
        return {name: np.array(values) for name, values in least.items()}


def walk(landscape: Landscape, observations: Observations, frames: range, curves: bool):
    """Track from the selected frame before the first one on; yield what is found in every wanted frame."""
    known = [frame for frame in observations.key_poses if frame <= frames.start]
    begin = max(known) if known else min(observations.key_poses)
    state: TrackingState | None = None
    worker = landscape.worker
    span = range(begin, frames.stop)
    for shown in progress(observations.frames(span), total=len(span), description="frames"):
        if state is None:
            state = worker.first(shown, observations.key_poses[begin]).state
            continue
        history = state.history
        step = worker.track(state, shown)
        state = step.state
        if shown.frame in frames and state.recent and state.recent[-1].frame.number == shown.frame:
            frame = state.recent[-1].frame
            bent = landscape.curves(frame, step.result.pose) if curves else {}
            yield landscape.compare(frame, history, step.result.pose), bent


def summary(found: list[tuple[Compared, dict[str, np.ndarray]]]) -> list[Figure]:
    """Shares and medians over the frames in which the found pose is clearly worse."""
    compared = [one for one, _ in found]
    errors = 100 * np.array([one.errors for one in compared])
    figures = [
        record("frames", len(compared), "", 0.0),
        record("joints, found", float(errors[:, 0].mean()), "cm", 0.2),
        record("joints, best fit", float(errors[:, 1].mean()), "cm", 0.1),
        record("joints, best fit refined", float(errors[:, 2].mean()), "cm", 0.2),
    ]
    worse = np.array([one.errors[0] > one.errors[2] + WORSE for one in compared])
    figures.append(record("frames clearly worse than the refined best fit", int(worse.sum()), "", 0.3))
    if worse.any():
        figures.append(record("in these: joints, found", float(errors[worse, 0].mean()), "cm", 0.2))
        figures.append(record("in these: joints, best fit refined", float(errors[worse, 2].mean()), "cm", 0.2))
    for name in compared[0].objectives:
        values = np.array([one.objectives[name] for one in compared])[worse]
        if len(values):
            lower = float((values[:, 2] < values[:, 0]).mean())
            figures.append(record(f"{name}: lower at the refined best fit", lower, "", 0.1, "higher"))
            ratio = float(np.median(values[:, 2] / np.maximum(np.abs(values[:, 0]), 1e-9)))
            figures.append(record(f"{name}: median ratio, refined best fit to found", ratio, "", 0.1))
    if found[0][1]:
        for name in found[0][1]:
            angles = np.abs([bent[name] for _, bent in found])
            figures.append(record(f"{name}: least lies this far from the best fit", float(angles.mean()), "deg", 0.2))
    return figures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", type=Path)
    parser.add_argument("--frames", default="0:30", help="A:B")
    parser.add_argument("--quality", default="normal")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=VALUE")
    parser.add_argument("--curves", action="store_true")
    add_options(parser)
    options = parser.parse_args()
    capture, key = Capture.open(options.capture), jax.random.key(options.seed)
    character = open_character(capture)
    made = register_and_learn(capture, character, key, None, options.quality, True)
    observations = observe(capture, capture.cameras, character, made.appearance, made.registrations)
    tracker = with_settings(Tracker.preset(options.quality), dict(one.split("=", 1) for one in options.set))
    landscape = Landscape(observations, tracker, jax.random.fold_in(key, 3))
    first, stop = map(int, options.frames.split(":"))
    found = list(walk(landscape, observations, range(first, stop), options.curves))
    return finish(summary(found), options, capture=capture.name, frames=options.frames, seed=options.seed)


if __name__ == "__main__":
    raise SystemExit(main())
