"""Refinement over the whole clip: every frame's answer, smooth motion, and feet that stay where they stand."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxmocap.character import ROOT_DOFS, Pose, Skeleton, landmark_positions, retract
from jaxmocap.motion import Contact, evened

from ._contacts import find_contacts
from ._flow_steps import FlowSteps
from ._system import (
    ClipRows,
    body_points,
    energy_at,
    linearise,
    normal_equations,
    point_covariances,
    third_differences,
)

DAMPING = 1e-6
"""Of the first step, as a share of the diagonal (Levenberg and Marquardt)."""

STEPS = 20
"""Of Levenberg and Marquardt at most."""

SETTLED = 2e-3
"""Share of the energy: a step that takes away less is the last one."""

WALL = 1e5
"""Weight of an angle beyond its limit, 1/rad^2: ten times what the points of a forearm say of its elbow."""

NEAR = 100.0
"""Weight of an increment, 1/rad^2 and 1/m^2, a tenth of what the three points of a single body say of its turns."""

WINDOW, MARGIN = 512, 48
"""Frames that are solved at once, and of these the frames next to a neighbouring window that are the neighbour's: what
is so far away has a millionth of its influence, a hundredth where a limb is in doubt all the while."""

SLIP = 0.005
"""Metres that a standing point may creep in a second, standard deviation."""

OPEN = 1e-3
"""Share of the median of J^T J's diagonal that is added to it: what nothing tells stays finite."""

LEAST = 0.1
"""Confidence that a landmark has at least: where nothing else tells of it, it stays where it was found."""


@dataclass(frozen=True)
class ClipPlan:
    """Say how a tracked clip is solved as a whole, after its last frame; not in the paper.

    Attributes:
        deviation: metres by which points of the body err at random from frame to frame, along one axis; 0.005.
        jerk: spectral density of a point's jerk along one axis, m^2/s^5: how suddenly the person may move, at
            any frame rate; 3000.
        contacts: find feet that stand and hold them; True.
        flow: look at the pictures again, for how the surface moves from each frame to the next (`flow_steps`); True.
    """

    deviation: float = 0.005
    jerk: float = 3000.0
    contacts: bool = True
    flow: bool = True


class SolvedClip(NamedTuple):
    """Poses of a whole clip, and where feet stand in it; None where that was not looked for."""

    poses: Pose
    contacts: list[Contact] | None


def solve_clip(
    skeleton: Skeleton,
    poses: Pose,
    timestamps: Float[np.ndarray, " frame"],
    confidence: Float[np.ndarray, "frame landmark"] | None = None,
    up: str = "y",
    plan: ClipPlan | None = None,
    steps: FlowSteps | None = None,
    hessians: Sequence[Float[np.ndarray, "dof dof"] | None] | None = None,
) -> SolvedClip:
    """Move the poses of all frames together to where they are likeliest, given that bodies move smoothly.

    Minimises over an increment of every frame the squared ways of the body's points from where they were found, by
    `plan.deviation` and the landmarks' confidence, and their squared jerks, by `plan.jerk`, inside the joint limits.
    Feet that stand in the solution hold still in a second one. This is what Eq. 10 asks of neighbouring frames, asked
    of all at once. `steps` are the ways from frame to frame that optical flow sees, measured along the poses that come
    out without them; whether that is done `plan.flow` tells whoever has the pictures. `hessians` are each frame's J^T J
    of the refinement: by its inverse points count less in directions of which the frame says little, as the line of
    sight.

    Each step of Levenberg and Marquardt solves a system that joins no frames farther apart than three, and long clips
    are solved in windows that overlap, so that time grows linearly with the clip and memory does not. `poses` are
    stacked along the first axis, `timestamps` are seconds, as far apart as they are; what a container rounded of an
    even rate is taken out. Fewer than four frames stay as they are.
    """
    plan = ClipPlan() if plan is None else plan
    if len(timestamps) < 4:
        return SolvedClip(poses, None)
    timestamps = evened(timestamps)
    if confidence is None:
        confidence = np.ones((len(timestamps), len(skeleton.landmark_names)))
    told = _told(skeleton, poses, confidence, hessians) / plan.deviation**2
    solved = _in_windows(skeleton, poses, timestamps, told, plan, [], steps)
    contacts: list[Contact] | None = None
    if plan.contacts:
        places = np.asarray(_landmarks(skeleton, solved))
        contacts = find_contacts(places, timestamps, skeleton, np.eye(3)["xyz".index(up)])
    if contacts:
        solved = _in_windows(skeleton, poses, timestamps, told, plan, contacts, steps)
    return SolvedClip(solved, contacts)


_landmarks = jax.jit(jax.vmap(landmark_positions, in_axes=(None, 0)))
_moved = jax.jit(jax.vmap(retract, in_axes=(None, 0, 0)))


def _told(
    skeleton: Skeleton,
    poses: Pose,
    confidence: Float[np.ndarray, "frame landmark"],
    hessians: Sequence[Float[np.ndarray, "dof dof"] | None] | None,
) -> Float[np.ndarray, "frame point 3 3"]:
    """How well each point is told in each direction: its landmark's confidence, times 1 in the median direction."""
    points = body_points(skeleton)
    weights = np.maximum(confidence, LEAST)[:, points.landmark, None, None] * np.eye(3)
    known = [number for number, hessian in enumerate(hessians or ()) if hessian is not None]
    if hessians is None or not known:
        return weights
    found = np.array([hessians[number] for number in known], np.float64)
    diagonal = np.einsum("tdd->td", found)
    diagonal += OPEN * np.median(diagonal)
    spread = point_covariances(skeleton, points, jax.tree.map(lambda leaf: leaf[np.array(known)], poses), found)
    directions = np.linalg.inv(np.eye(3) + spread / np.median(np.einsum("tpaa->tp", spread) / 3))
    weights[known] = weights[known] @ directions / np.median(np.einsum("tpaa->tp", directions) / 3)
    return weights


def _in_windows(
    skeleton: Skeleton,
    poses: Pose,
    timestamps: Float[np.ndarray, " frame"],
    told: Float[np.ndarray, "frame point 3 3"],
    plan: ClipPlan,
    contacts: list[Contact],
    steps: FlowSteps | None,
) -> Pose:
    """Solve window after window; of an overlap each of two windows has the half that is farther from its edge."""
    frames, kept = len(timestamps), []
    for first in range(0, max(frames - 2 * MARGIN, 1), WINDOW - 2 * MARGIN):
        last = min(first + WINDOW, frames)
        within = [
            Contact(name, max(begin, first) - first, min(end, last - 1) - first)
            for name, begin, end in contacts
            if begin < last and end >= first
        ]
        part = jax.tree.map(lambda leaf, span=slice(first, last): leaf[span], poses)
        seen = None if steps is None else FlowSteps(*(leaf[first : last - 1] for leaf in steps))
        solved = _descend(skeleton, part, timestamps[first:last], told[first:last], plan, within, seen)
        span = slice(MARGIN if first else 0, last - first if last == frames else WINDOW - MARGIN)
        kept.append(jax.tree.map(lambda leaf, span=span: np.asarray(leaf)[span], solved))
    return jax.tree.map(lambda *leaves: jax.device_put(np.concatenate(leaves)), *kept)


def _descend(
    skeleton: Skeleton,
    poses: Pose,
    timestamps: Float[np.ndarray, " frame"],
    told: Float[np.ndarray, "frame point 3 3"],
    plan: ClipPlan,
    contacts: list[Contact],
    steps: FlowSteps | None,
) -> Pose:
    points, seconds = body_points(skeleton), np.diff(timestamps)
    steady, ways = np.zeros((len(seconds), len(points.body), 3, 3)), np.zeros((len(seconds), len(points.body), 3))
    if steps is not None:
        steady, ways = np.linalg.inv(steps.covariance), steps.ways.copy()
    for name, first, last in contacts:
        point = skeleton.landmark_names.index(name)
        steady[first:last, point] = np.eye(3) / (SLIP**2 * seconds[first:last, None, None])
        ways[first:last, point] = 0.0
    lower, upper = _room(skeleton, poses)
    rows = ClipRows(
        told=told,
        differences=third_differences(timestamps),
        smooth=np.repeat((timestamps[3:] - timestamps[:-3])[:, None] / 3 / plan.jerk, len(points.body), axis=1),
        steady=steady,
        ways=ways,
        lower=lower,
        upper=upper,
        wall=WALL,
        near=NEAR,
    )
    increments, damping = np.zeros(lower.shape), DAMPING
    found, moves = linearise(skeleton, points, poses, increments)
    energy = energy_at(found, found, increments, rows)
    system = normal_equations(found, found, moves, increments, rows)
    for _ in range(STEPS):
        step = system.step(damping)
        places, moves = linearise(skeleton, points, poses, increments + step)
        after = energy_at(found, places, increments + step, rows)
        if after > energy:
            damping *= 100
            continue
        settled = after > energy * (1 - SETTLED)
        increments, damping, energy = increments + step, damping / 10, after
        if settled:
            break
        system = normal_equations(found, places, moves, increments, rows)
    increments = np.clip(increments, lower, upper)
    return _moved(skeleton, poses, jnp.asarray(increments, jnp.float32))


def _room(skeleton: Skeleton, poses: Pose) -> tuple[Float[np.ndarray, "frame dof"], Float[np.ndarray, "frame dof"]]:
    """How far each increment may go down and up; a pose beyond a limit may stay where it is."""
    angles = np.asarray(poses.angles, np.float64)
    far = np.full((len(angles), ROOT_DOFS), 1e3)
    lower = np.minimum(np.asarray(skeleton.lower) - angles, 0)
    upper = np.maximum(np.asarray(skeleton.upper) - angles, 0)
    return np.concatenate([-far, lower], axis=1), np.concatenate([far, upper], axis=1)
