"""The skeleton: 18 bodies moved by 39 degrees of freedom (Sec. 3.1)."""

from functools import lru_cache

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float


class Skeleton(eqx.Module):
    """A tree of bodies and the hinge axes between them, all written in the rest pose.

    Rest frame: x = subject's left, y up, z forward, metres. Angles are zero at rest. The order of the degrees of
    freedom is root (3 translations, 3 rotations), torso, left arm, right arm, left leg, right leg.
    """

    body_names: tuple[str, ...] = eqx.field(static=True)
    parents: tuple[int, ...] = eqx.field(static=True)
    dof_names: tuple[str, ...] = eqx.field(static=True)
    dof_body: tuple[int, ...] = eqx.field(static=True)
    groups: tuple[tuple[str, tuple[int, ...]], ...] = eqx.field(static=True)
    landmark_names: tuple[str, ...] = eqx.field(static=True)
    landmark_bodies: tuple[int, ...] = eqx.field(static=True)
    axes: Float[Array, "dof 3"]
    origins: Float[Array, "dof 3"]
    lower: Float[Array, " dof"]
    upper: Float[Array, " dof"]
    landmarks: Float[Array, "landmark 3"]

    @property
    def num_dofs(self) -> int:
        """Length of an increment: 39."""
        return len(self.dof_names)

    @property
    def num_angles(self) -> int:
        """Number of joint angles: 33."""
        return len(self.dof_body)

    @property
    def pelvis(self) -> Float[Array, "3"]:
        """Rest position of the pelvis, the point the root rotation turns about."""
        return self.landmarks[self.landmark_names.index("pelvis")]

    def group(self, name: str) -> tuple[int, ...]:
        """Indices, among the 39, of the degrees of freedom of a group such as `l_arm`."""
        return dict(self.groups)[name]

    def landmark(self, name: str) -> Float[Array, "3"]:
        """Rest position of a landmark such as `l_elbow`."""
        return self.landmarks[self.landmark_names.index(name)]

    def moved_by(self) -> Bool[np.ndarray, "dof bone"]:
        """Which bodies each joint degree of freedom moves: the body it is attached to and all its descendants."""
        return _moved_by(self.parents, self.dof_body)


@lru_cache(maxsize=16)
def _moved_by(parents: tuple[int, ...], dof_body: tuple[int, ...]) -> np.ndarray:
    below = np.eye(len(parents), dtype=bool)
    for body, parent in enumerate(parents):
        if parent >= 0:
            below[:, body] |= below[:, parent]
    return below[list(dof_body)]
