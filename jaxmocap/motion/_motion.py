"""The record of a tracked motion: what was found, how sure we are, and how it came about."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Self

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras
from jaxmocap.character import Character, Pose, body_transforms, landmark_positions, pose_vector, skin

from ._check_motion import check_motion, frozen

TAILS = 2.3
"""Degrees of freedom of Student's t that the errors of joints follow, about their covariance as the scale matrix."""


class Contact(NamedTuple):
    """Say that a heel or toe stands.

    Attributes:
        landmark: its name, such as "l_heel".
        first: frame, as `Motion.frames` counts; position in the clip while one is solved.
        last: the same, of the last in which it stands.
    """

    landmark: str
    first: int
    last: int


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion of one character over T frames. Arrays are NumPy, read-only; lengths in metres, angles in radians.

    `root` is `world_from_body` and `angles` the joint angles: together the pose of Eq. 2. `frames` are frame numbers
    of the first camera's video and `timestamps` their times in seconds since its first frame. `joints` are the
    skeleton's landmarks, named by `joint_names`; `confidence` in [0, 1] is theirs, and `covariance`, when known, that
    of their places, square metres: the scale matrix of Student's t with `TAILS` degrees of freedom, since a limb is
    found or mistaken. `energy` holds each term's value per frame, NaN where it was not evaluated. `status`
    says per frame "ok", "doubtful" or "lost". `cameras`, when known, has the frame axis of this motion. `provenance`
    holds whatever tells how it was made, as JSON knows it; the key `seconds_per_frame` is read by `evaluate`. `up` is
    the world's vertical axis, "x", "y" or "z".

    Raises `InputError` if shapes disagree, a pose is not finite or rigid, frames or timestamps do not increase, or a
    status is unknown.
    """

    character: Character
    root: Float[np.ndarray, "frame 4 4"]
    angles: Float[np.ndarray, "frame angle"]
    frames: Int[np.ndarray, " frame"]
    timestamps: Float[np.ndarray, " frame"]
    joints: Float[np.ndarray, "frame joint 3"]
    confidence: Float[np.ndarray, "frame joint"]
    status: np.ndarray
    energy: Mapping[str, Float[np.ndarray, " frame"]] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    cameras: Cameras | None = None
    up: str = "y"
    covariance: Float[np.ndarray, "frame joint 3 3"] | None = None

    def __post_init__(self) -> None:
        dtypes = {"root": np.float32, "angles": np.float32, "frames": np.int64, "timestamps": np.float64}
        dtypes |= {"joints": np.float32, "confidence": np.float32, "status": np.str_}
        if self.covariance is not None:
            dtypes["covariance"] = np.float32
        for name, dtype in dtypes.items():
            object.__setattr__(self, name, frozen(getattr(self, name), dtype))
        object.__setattr__(
            self, "energy", {name: frozen(values, np.float32) for name, values in sorted(self.energy.items())}
        )
        check_motion(self)

    @classmethod
    def from_poses(
        cls,
        character: Character,
        poses: Pose,
        frames: Sequence[int] | np.ndarray,
        timestamps: Sequence[float] | np.ndarray,
        *,
        confidence: np.ndarray | None = None,
        status: Sequence[str] | np.ndarray | None = None,
        energy: Mapping[str, np.ndarray] | None = None,
        provenance: Mapping[str, Any] | None = None,
        cameras: Cameras | None = None,
        up: str = "y",
        covariance: np.ndarray | None = None,
    ) -> Self:
        """Build a motion from stacked poses; `joints` are computed. Confidence defaults to 1 and status to "ok".

        `cameras` have the frame axis of the poses; `cameras_at` takes those out of a whole capture's.
        """
        joints = np.asarray(_joints(character.skeleton, poses))
        return cls(
            character=character,
            root=np.asarray(poses.root),
            angles=np.asarray(poses.angles),
            frames=np.asarray(frames),
            timestamps=np.asarray(timestamps),
            joints=joints,
            confidence=np.ones(joints.shape[:2]) if confidence is None else confidence,
            status=np.full(len(joints), "ok") if status is None else np.asarray(status),
            energy=energy or {},
            provenance=provenance or {},
            cameras=cameras,
            up=up,
            covariance=covariance,
        )

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, selection: slice | np.ndarray) -> "Motion":
        """Cut out some of the motion's frames: a slice, increasing positions, or a boolean mask."""
        if not isinstance(selection, slice):
            selection = np.asarray(selection)
        names = ("root", "angles", "frames", "timestamps", "joints", "confidence", "status")
        chosen: dict[str, Any] = {name: getattr(self, name)[selection] for name in names}
        if self.covariance is not None:
            chosen["covariance"] = self.covariance[selection]
        chosen["energy"] = {name: values[selection] for name, values in self.energy.items()}
        if self.cameras is not None:
            chosen["cameras"] = cameras_at(self.cameras, np.arange(len(self))[selection])
        return replace(self, **chosen)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the J landmarks in `joints` and `confidence`."""
        return self.character.skeleton.landmark_names

    @property
    def dof_names(self) -> tuple[str, ...]:
        """Names of the degrees of freedom in `pose_vectors`."""
        return self.character.skeleton.dof_names

    @property
    def poses(self) -> Pose:
        """All poses, stacked along the first axis."""
        return Pose(root=jax.device_put(self.root), angles=jax.device_put(self.angles))

    def pose(self, index: int) -> Pose:
        """Return the pose at position `index` of this motion."""
        return Pose(root=jax.device_put(self.root[index]), angles=jax.device_put(self.angles[index]))

    def vertices(self, index: int) -> Float[np.ndarray, "vertex 3"]:
        """Skin the mesh (Eq. 1) at position `index` of this motion, metres."""
        return np.asarray(_skin(self.character, self.pose(index)))

    @cached_property
    def pose_vectors(self) -> Float[np.ndarray, "frame dof"]:
        """Each pose as the increment that `retract` applies to the rest pose; columns are `dof_names`."""
        return np.asarray(_pose_vectors(self.character.skeleton, self.poses))

    @cached_property
    def body_transforms(self) -> Float[np.ndarray, "frame bone 4 4"]:
        """`world_from_rest` of the bodies in every frame (Eq. 2)."""
        return np.asarray(_transforms(self.character.skeleton, self.poses))

    @property
    def joint_deviations(self) -> Float[np.ndarray, "frame joint"] | None:
        """Standard deviation of each joint's place along one axis, metres: the root of the mean over the three.

        Of most errors, not of the few large ones (`TAILS`). None where the covariance is not known.
        """
        if self.covariance is None:
            return None
        return np.sqrt(np.maximum(np.trace(self.covariance.astype(np.float64), axis1=2, axis2=3), 0) / 3)

    @property
    def trusted(self) -> Bool[np.ndarray, " frame"]:
        """Which frames are to be trusted, all limbs of them: the status is "ok", and `provenance["lost"]` names no part
        there. What was not tracked in images is trusted."""
        spans = self.provenance.get("lost") or []
        lost = [(self.frames >= span["first"]) & (self.frames <= span["last"]) for span in spans]
        return (self.status == "ok") & ~np.any([np.zeros(len(self), bool), *lost], axis=0)

    @property
    def contacts(self) -> tuple[Contact, ...] | None:
        """Where heels and toes stand, within this motion's frames; None where nobody looked for that.

        Empty, they were looked for and none was found. A view of `provenance["contacts"]`.
        """
        spans = self.provenance.get("contacts")
        if spans is None:
            return None
        found = []
        for span in spans:
            left = self.frames[(self.frames >= span["first"]) & (self.frames <= span["last"])]
            if len(left):
                found.append(Contact(span["landmark"], int(left[0]), int(left[-1])))
        return tuple(found)

    @property
    def foot_contact(self) -> Bool[np.ndarray, "frame foot"] | None:
        """Whether the left and the right foot stand: each does while its heel or its toe does, by `contacts`.

        None where nobody looked for contacts.
        """
        if self.contacts is None:
            return None
        stands = np.zeros((len(self), 2), bool)
        for landmark, first, last in self.contacts:
            stands[(self.frames >= first) & (self.frames <= last), "lr".index(landmark[0])] = True
        return stands

    @property
    def seconds_per_interval(self) -> float:
        """Median time between two frames, seconds; 0 for a single frame."""
        return float(np.median(np.diff(self.timestamps))) if len(self) > 1 else 0.0

    def save(self, folder: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
        """Write `motion.npz` and `report.json` into `folder`, atomically; see `motion/_arrays.py` for the schema.

        Raises `InputError` if the folder holds a `motion.npz` already and `overwrite` is false.
        """
        from ._storage import save

        return save(self, folder, overwrite=overwrite)

    @classmethod
    def load(cls, folder: str | os.PathLike[str]) -> "Motion":
        """Read a result folder, or its `motion.npz`. `InputError` if it is none, is damaged, or is too new for us."""
        from ._storage import load

        return load(folder)


_skin = jax.jit(skin)
_joints = jax.jit(jax.vmap(landmark_positions, in_axes=(None, 0)))
_transforms = jax.jit(jax.vmap(body_transforms, in_axes=(None, 0)))
_rows = jax.jit(lambda array, positions: array[:, positions])
_pose_vectors = jax.jit(jax.vmap(pose_vector, in_axes=(None, 0)))


def cameras_at(cameras: Cameras, positions: Sequence[int] | np.ndarray) -> Cameras:
    """Take the cameras at some positions of their frame axis. Raises `InputError` if they do not reach that far."""
    positions = np.asarray(positions)
    if len(positions) and positions.max() >= cameras.num_frames:
        raise InputError(f"Frame {positions.max()} has no camera pose: the cameras cover {cameras.num_frames} frames.")
    return replace(cameras, cam_from_world=_rows(cameras.cam_from_world, positions))
