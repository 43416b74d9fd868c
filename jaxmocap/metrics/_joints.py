"""Joint errors: raw, root-aligned, after Procrustes, and with constant offsets in the bodies' frames removed."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.special import fdtri

from jaxmocap._results import InputError
from jaxmocap.geometry import IDENTITY, Similarity, fit_similarity
from jaxmocap.motion import TAILS, Motion

from ._motion_quality import accelerations

_LIMBS = tuple(f"{side}_{part}" for side in "lr" for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle"))
COMPARABLE = ("neck", *_LIMBS)
"""Joints that every rig and detector puts in nearly the same place. The others are points along the trunk or on the
head that each rig chooses for itself: `pelvis` is the middle of the hips or a hand's breadth above it, `spine` any
vertebra, `head` the joint below the skull or its centre."""

JOINTS = ("pelvis", "spine", "thorax", "neck", "head", *_LIMBS)
"""Joints of the skeleton, without the landmarks on its surface (nose, toes, heels)."""

_LEAST_VARIANCE = 1e-12
"""Square metres added to every covariance, so that one of a joint that is said to be certain can be divided by."""

Joints = Literal["comparable", "all"] | Sequence[str]
"""Which joints to score: those in `COMPARABLE`, those in `JOINTS`, or exactly these names."""


@dataclass(frozen=True)
class JointErrors:
    """Distances per frame and joint in metres, NaN where the truth has none.

    Attributes:
        names: the joints compared, the columns of the others.
        raw: between world positions.
        root_aligned: after the pelvis (else the middle of the hips) is moved onto the true one; None where neither is
            known.
        procrustes: after the best similarity of each frame (PA-MPJPE).
        offset_corrected: without each joint's mean residual in the frame of the body it belongs to: two definitions of
            a joint that differ by a fixed vector on the bone then agree.
        acceleration: |a - a*| at inner frames, m/s^2.
        deviations: raw, in standard deviations of the motion's covariance (Mahalanobis); None without one.
        left_out: mean raw error of every joint that both sides know and that is not among `names`.
    """

    names: tuple[str, ...]
    raw: Float[np.ndarray, "frame joint"]
    root_aligned: Float[np.ndarray, "frame joint"] | None
    procrustes: Float[np.ndarray, "frame joint"]
    offset_corrected: Float[np.ndarray, "frame joint"]
    acceleration: Float[np.ndarray, "inner joint"]
    deviations: Float[np.ndarray, "frame joint"] | None
    left_out: dict[str, float]

    def by_name(self) -> dict[str, float]:
        """Average the raw error of every joint in `names` over the frames, metres."""
        return _by_name(self.names, self.raw)

    def correct_keypoints(self, radius: float = 0.15) -> float:
        """Give the PCK, the share of raw distances below `radius` metres."""
        return float(np.mean(self.raw[np.isfinite(self.raw)] < radius))

    def coverage(self, share: float) -> float:
        """Measure how often the truth lies in the region that should hold this share of it.

        The region is an ellipsoid about the place found, of Student's t (`motion.TAILS`). NaN without a covariance.
        """
        if self.deviations is None:
            return float("nan")
        known = self.deviations[np.isfinite(self.deviations)]
        return float(np.mean(known**2 <= 3 * fdtri(3, TAILS, share)))


def joint_errors(
    motion: Motion,
    truth: Float[np.ndarray, "frame joint 3"],
    names: Sequence[str],
    *,
    joints: Joints = "comparable",
    truth_from_world: Similarity = IDENTITY,
) -> JointErrors:
    """Compare the motion's joints with `truth` (metres, one row per frame, columns called `names`).

    Of the joints that both sides know, those in `COMPARABLE` are compared, or "all" those in `JOINTS`, or exactly the
    names in `joints`. `truth_from_world` brings the motion's world to the truth's. Raises `InputError` if there is no
    joint to compare, a name in `joints` is unknown to either side, or rows and frames do not match.
    """
    truth = np.asarray(truth, np.float64)
    if truth.shape != (len(motion), len(names), 3):
        raise InputError(
            f"True joints have shape {truth.shape}; ({len(motion)}, {len(names)}, 3) was expected: frames, names, 3."
        )
    compared = _joints_to_compare(motion.joint_names, names, joints)
    others = tuple(name for name in motion.joint_names if name in names and name not in compared)
    truth = np.where(np.isfinite(truth).all(-1, keepdims=True), truth, np.nan)

    def pairs(wanted: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        places = motion.joints[:, [motion.joint_names.index(name) for name in wanted]].astype(np.float64)
        return truth_from_world(places), truth[:, [list(names).index(name) for name in wanted]]

    ours = [motion.joint_names.index(name) for name in compared]
    found, true = pairs(compared)
    if not np.isfinite(true).any():
        raise InputError("No true joint is known in any of the evaluated frames.")

    bodies = [motion.character.skeleton.landmark_bodies[joint] for joint in ours]
    rotations = truth_from_world.rotation @ motion.body_transforms[:, bodies, :3, :3].astype(np.float64)
    deviations = None
    if motion.covariance is not None:
        turn = truth_from_world.scale * truth_from_world.rotation
        covariance = turn @ motion.covariance[:, ours].astype(np.float64) @ turn.T + _LEAST_VARIANCE * np.eye(3)
        whitened = np.linalg.solve(np.linalg.cholesky(covariance), (true - found)[..., None])
        deviations = _lengths(whitened[..., 0])
    local = np.einsum("tjik,tji->tjk", rotations, true - found)
    return JointErrors(
        names=compared,
        raw=_lengths(true - found),
        root_aligned=_root_aligned(compared, found, true),
        procrustes=np.stack([_after_procrustes(*frame) for frame in zip(found, true, strict=True)]),
        offset_corrected=_lengths(local - _mean_over_frames(local)),
        acceleration=_lengths(accelerations(true, motion.timestamps) - accelerations(found, motion.timestamps)),
        deviations=deviations,
        left_out=_by_name(others, _lengths(np.subtract(*pairs(others)))),
    )


def joint_statistics(distances: Float[np.ndarray, "frame joint"]) -> dict[str, float]:
    """Summarise single points by mean, 95th percentile and maximum, centimetres."""
    points = distances[np.isfinite(distances)] * 100
    return {"mean": float(points.mean()), "p95": float(np.percentile(points, 95)), "max": float(points.max())}


def _joints_to_compare(ours: Sequence[str], theirs: Sequence[str], wanted: Joints) -> tuple[str, ...]:
    if isinstance(wanted, str) and wanted not in ("comparable", "all"):
        raise InputError(f"The joints to score are {wanted!r}; 'comparable', 'all' or a list of names was expected.")
    if not isinstance(wanted, str):
        for name in wanted:
            for side, known in (("skeleton", ours), ("truth", theirs)):
                if name not in known:
                    raise InputError(f"The {side} has no joint {name!r}; it has {', '.join(known)}.")
        return tuple(wanted)
    common = tuple(name for name in ours if name in theirs and name in JOINTS)
    if not common:
        raise InputError(
            f"The truth's joints ({', '.join(theirs)}) and the skeleton's ({', '.join(ours)}) have no name in common."
        )
    chosen = common if wanted == "all" else tuple(name for name in common if name in COMPARABLE)
    if not chosen:
        raise InputError(
            f"The truth and the skeleton have only {', '.join(common)} in common, which rigs put in different places; "
            "neck, shoulders, elbows, wrists, hips, knees or ankles were expected. Score them with joints 'all'."
        )
    return chosen


def _root_aligned(names: tuple[str, ...], found: np.ndarray, true: np.ndarray) -> np.ndarray | None:
    roots = ("pelvis",) if "pelvis" in names else ("l_hip", "r_hip")
    if not all(name in names for name in roots):
        return None
    index = [names.index(name) for name in roots]
    shift = (true[:, index] - found[:, index]).mean(axis=1, keepdims=True)
    return _lengths(true - found - shift)


def _after_procrustes(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    known = np.isfinite(true).all(-1)
    if known.sum() < 3:
        return np.full(len(true), np.nan)
    return _lengths(true - fit_similarity(found[known], true[known])(found))


def _by_name(names: Sequence[str], distances: np.ndarray) -> dict[str, float]:
    return dict(zip(names, map(float, _mean_over_frames(distances)), strict=True))


def _mean_over_frames(values: np.ndarray) -> np.ndarray:
    """Mean over the first axis of what is finite; NaN where nothing is."""
    known = np.isfinite(values)
    count = known.sum(0)
    return np.where(count > 0, np.where(known, values, 0.0).sum(0) / np.maximum(count, 1), np.nan)


def _lengths(vectors: np.ndarray) -> np.ndarray:
    return np.linalg.norm(vectors, axis=-1)
