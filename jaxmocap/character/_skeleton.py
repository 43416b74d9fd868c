"""The skeleton: bodies moved by degrees of freedom (Sec. 3.1), and everything that is counted or named by them."""

from functools import lru_cache

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmocap._results import InputError

ROOT_DOFS = 6
"""Degrees of freedom of the root, the first ones of every skeleton: three translations, three rotations."""

SIDES = {"l_": "left", "r_": "right"}
"""How the names of groups, bodies, joints and degrees of freedom of one side begin, and what the side is called."""


def is_limb(group: str) -> bool:
    """Tell by its name whether a group of degrees of freedom belongs to one side of the body: an arm or a leg."""
    return group[:2] in SIDES


class Skeleton(eqx.Module):
    """A tree of bodies and the hinge axes between them, all written in the rest pose.

    Rest frame: x = subject's left, y up, z forward, metres. Angles are zero at rest. Degrees of freedom are the root's
    (3 translations, 3 rotations), then the joint angles. A person has 39 of them in the order root, torso, left arm,
    right arm, left leg, right leg; nothing outside this package counts on that.

    Attributes:
        body_names: bodies, parents before children; the first one is the pelvis.
        parents: of each body its parent's number; -1 of the first.
        dof_names: degrees of freedom, those of the root first.
        dof_body: of each joint angle the body it is attached to.
        groups: name and degrees of freedom of each group that is searched at once (Sec. 4.1), in the order of the
            search. A name that begins with `l_` or `r_` is that of a limb.
        dof_spread: of each degree of freedom the standard deviation of the first particles, metres and radians.
        distal: degrees of freedom of limbs that leave the bone next to the trunk where it is.
        posture: degrees of freedom of the trunk, which a straight posture keeps small.
        landmark_names: joints about which the bodies turn, one per body in the order of the bodies, then other points.
        landmark_bodies: of each landmark the body that carries it.
        axes: unit direction of each joint angle's axis.
        origins: a point on each axis, metres.
        lower: smallest joint angles, radians.
        upper: largest joint angles, radians.
        landmarks: places at rest, metres.
    """

    body_names: tuple[str, ...] = eqx.field(static=True)
    parents: tuple[int, ...] = eqx.field(static=True)
    dof_names: tuple[str, ...] = eqx.field(static=True)
    dof_body: tuple[int, ...] = eqx.field(static=True)
    groups: tuple[tuple[str, tuple[int, ...]], ...] = eqx.field(static=True)
    dof_spread: tuple[float, ...] = eqx.field(static=True)
    distal: tuple[int, ...] = eqx.field(static=True)
    posture: tuple[int, ...] = eqx.field(static=True)
    landmark_names: tuple[str, ...] = eqx.field(static=True)
    landmark_bodies: tuple[int, ...] = eqx.field(static=True)
    axes: Float[Array, "angle 3"]
    origins: Float[Array, "angle 3"]
    lower: Float[Array, " angle"]
    upper: Float[Array, " angle"]
    landmarks: Float[Array, "landmark 3"]

    @property
    def num_dofs(self) -> int:
        """Length of an increment: the root's degrees of freedom and the joint angles."""
        return len(self.dof_names)

    @property
    def num_angles(self) -> int:
        """Number of joint angles."""
        return len(self.dof_body)

    @property
    def angle_names(self) -> tuple[str, ...]:
        """Names of the joint angles."""
        return self.dof_names[ROOT_DOFS:]

    @property
    def pelvis(self) -> Float[Array, "3"]:
        """Rest position of the first body's joint, the point the root rotation turns about."""
        return self.landmarks[0]

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Of each body the joint about which it turns."""
        return self.landmark_names[: len(self.body_names)]

    @property
    def joints(self) -> Float[np.ndarray, "bone 3"]:
        """Rest positions of the `joint_names`, metres (host)."""
        return np.asarray(self.landmarks)[: len(self.body_names)]

    @property
    def limbs(self) -> tuple[str, ...]:
        """Names of the groups that are limbs, in the order of the groups."""
        return tuple(name for name, _ in self.groups if is_limb(name))

    @property
    def limb_labels(self) -> dict[str, str]:
        """What people call the limbs, such as "left arm", by the name of their group."""
        return {name: f"{SIDES[name[:2]]} {self.kind(name)}" for name in self.limbs}

    @property
    def distal_bodies(self) -> list[Bool[np.ndarray, "body"]]:
        """Of each limb the bodies beyond the elbow or knee."""
        return [self.bodies_of(name, distal=True) for name in self.limbs]

    @property
    def initial_spread(self) -> Float[np.ndarray, "dof"]:
        """Standard deviation of the first particles, metres and radians, for a subject that moves at 1 m/s."""
        return np.array(self.dof_spread)

    def kind(self, group: str) -> str:
        """Return the name of a group without its side, such as "arm": groups of one kind share compiled shapes."""
        return group[2:] if is_limb(group) else group

    def group(self, name: str) -> tuple[int, ...]:
        """List the degrees of freedom of a group such as `l_arm`, as indices. Raises `InputError` for another name."""
        groups = dict(self.groups)
        if name not in groups:
            raise InputError(f"there is no group '{name}'; choose one of {', '.join(groups)}.")
        return groups[name]

    def distal_dofs(self, group: str) -> tuple[int, ...]:
        """List those of a limb's degrees of freedom that leave its upper arm or thigh where it is."""
        return tuple(dof for dof in self.group(group) if dof in self.distal)

    def landmark(self, name: str) -> Float[Array, "3"]:
        """Return the rest position of a landmark such as `l_elbow`, metres. Raises `InputError` for another name."""
        if name not in self.landmark_names:
            raise InputError(f"there is no landmark '{name}'; choose one of {', '.join(self.landmark_names)}.")
        return self.landmarks[self.landmark_names.index(name)]

    def per_dof(self, root: float, angles: float) -> Float[np.ndarray, "dof"]:
        """Repeat one number for every degree of freedom of the root and another for every joint angle."""
        return np.repeat(np.array([root, angles], np.float32), [ROOT_DOFS, self.num_angles])

    def moved_by(self) -> Bool[np.ndarray, "angle bone"]:
        """Mark which bodies each joint angle moves: the body it is attached to and all its descendants."""
        return _moved_by(self.parents, self.dof_body)

    def bodies_moved_by(self, dofs: tuple[int, ...]) -> Bool[np.ndarray, "bone"]:
        """Mark the bodies that any of some degrees of freedom moves; one of the root moves all."""
        if min(dofs) < ROOT_DOFS:
            return np.ones(len(self.body_names), bool)
        return np.asarray(self.moved_by()[np.array(dofs) - ROOT_DOFS].any(0))

    def bodies_of(self, group: str, distal: bool = False) -> Bool[np.ndarray, "bone"]:
        """Mark the bodies that a group moves; with `distal` only those beyond its elbow or knee.

        Those are the bodies that its distal degrees of freedom move and no other one of its own turns; those of the
        whole group, if it has none.
        """
        dofs, beyond = self.group(group), self.distal_dofs(group)
        if not (distal and beyond):
            return self.bodies_moved_by(dofs)
        turned = [self.dof_body[dof - ROOT_DOFS] for dof in dofs if dof not in beyond]
        return self.bodies_moved_by(beyond) & ~np.isin(np.arange(len(self.body_names)), turned)


@lru_cache(maxsize=16)
def _moved_by(parents: tuple[int, ...], dof_body: tuple[int, ...]) -> np.ndarray:
    below = np.eye(len(parents), dtype=bool)
    for body, parent in enumerate(parents):
        if parent >= 0:
            below[:, body] |= below[:, parent]
    return below[list(dof_body)]
