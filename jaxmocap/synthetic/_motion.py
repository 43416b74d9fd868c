"""A known motion: stepping in place with one high knee lift, arms swinging, the torso turning."""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxmocap._results import InputError
from jaxmocap.character import Pose, Skeleton, landmark_positions, pose_from_vector
from jaxmocap.motion import Motion, at_times, continuous, turned

Routine = Literal["dance", "crossing arms", "bending arm"]
STEP_RATE = 0.8
_KNEE_LIFT_TIME = 1.56
_SOFTNESS = 0.004

# Degree of freedom -> mean (degrees), then (amplitude in degrees, frequency in Hz, phase in turns) of its sinusoids.
# Angles are measured from the rest pose. Sides differ on purpose.
_SWINGS: dict[str, tuple[float, list[tuple[float, float, float]]]] = {
    "root_ry": (0.0, [(14, 0.25, 0.00)]),
    "lumbar_flex": (4.0, [(4, 0.80, 0.20)]),
    "lumbar_lat": (0.0, [(6, 0.40, 0.10)]),
    "lumbar_axial": (0.0, [(16, 0.45, 0.30)]),
    "thorax_flex": (3.0, [(4, 0.60, 0.00)]),
    "neck_flex": (3.0, [(6, 0.55, 0.40)]),
    "neck_lat": (0.0, [(5, 0.40, 0.60)]),
    "neck_axial": (0.0, [(18, 0.35, 0.75)]),
    "l_clav_elev": (6.0, [(6, 0.65, 0.00)]),
    "l_shoulder_flex": (14.0, [(22, 0.50, 0.25)]),
    "l_shoulder_abd": (12.0, [(35, 0.65, 0.00)]),
    "l_shoulder_axial": (0.0, [(16, 0.55, 0.10)]),
    "l_elbow_flex": (38.0, [(34, 0.80, 0.35)]),
    "l_forearm_pron": (0.0, [(25, 0.70, 0.00)]),
    "r_clav_elev": (5.0, [(5, 0.55, 0.50)]),
    "r_clav_protract": (4.0, [(6, 0.50, 0.20)]),
    "r_shoulder_flex": (20.0, [(26, 0.60, 0.70)]),
    "r_shoulder_abd": (4.0, [(32, 0.55, 0.45), (7, 1.10, 0.20)]),
    "r_shoulder_axial": (0.0, [(14, 0.45, 0.60)]),
    "r_elbow_flex": (44.0, [(38, 0.70, 0.90)]),
    "r_forearm_pron": (0.0, [(25, 0.60, 0.30)]),
    "l_hip_abd": (2.0, [(3, 0.40, 0.00)]),
    "r_hip_abd": (2.0, [(3, 0.40, 0.50)]),
}
# Both forearms sweep before the torso, and one arm bends and stretches; the rest hardly moves.
_CROSSING: dict[str, tuple[float, list[tuple[float, float, float]]]] = {
    "root_ry": (0.0, [(6, 0.3, 0.0)]),
    "lumbar_axial": (0.0, [(5, 0.4, 0.2)]),
    "l_shoulder_flex": (22.0, [(12, 1.3, 0.00)]),
    "l_shoulder_abd": (-22.0, [(8, 0.9, 0.30)]),
    "l_shoulder_axial": (48.0, [(22, 1.2, 0.55)]),
    "l_elbow_flex": (72.0, [(24, 1.4, 0.20)]),
    "r_shoulder_flex": (26.0, [(14, 1.1, 0.50)]),
    "r_shoulder_abd": (-22.0, [(8, 1.0, 0.75)]),
    "r_shoulder_axial": (48.0, [(22, 1.3, 0.05)]),
    "r_elbow_flex": (72.0, [(24, 1.2, 0.70)]),
}
_BENDING: dict[str, tuple[float, list[tuple[float, float, float]]]] = {
    "root_ry": (0.0, [(5, 0.3, 0.0)]),
    "l_shoulder_flex": (18.0, [(12, 0.9, 0.00)]),
    "l_shoulder_abd": (14.0, [(14, 0.7, 0.10)]),
    "l_shoulder_axial": (10.0, [(20, 0.8, 0.40)]),
    "l_elbow_flex": (55.0, [(48, 1.1, 0.75)]),
    "r_shoulder_flex": (10.0, [(8, 0.6, 0.20)]),
    "r_shoulder_abd": (-14.0, [(6, 0.6, 0.50)]),
    "r_elbow_flex": (25.0, [(18, 0.9, 0.00)]),
}
_ROUTINES = {"dance": (_SWINGS, 1.0), "crossing arms": (_CROSSING, 0.3), "bending arm": (_BENDING, 0.2)}
# Root sway in metres: mean, then (amplitude, frequency, phase in turns).
_SWAY: dict[str, list[tuple[float, float, float]]] = {
    "root_tx": [(0.10, 0.40, 0.05), (0.12, 0.13, 0.00)],
    "root_tz": [(0.12, 0.21, 0.25)],
}


# Turns while standing, in shares of the angle by which the whole body leans.
_STANCE = {
    "root_rx": 0.85,
    "root_rz": 0.5,
    "lumbar_axial": 1.0,
    "lumbar_flex": 0.3,
    "lumbar_lat": 0.3,
    "neck_flex": 1.0,
}
_STANCE |= {"neck_lat": 0.7, "neck_axial": 1.5, "shoulder_flex": 1.5, "shoulder_abd": 1.5, "elbow_flex": 2.0}
_SLOW = 0.05  # hertz


def dance(skeleton: Skeleton, times: Float[np.ndarray, "frame"], scale: float = 1.0) -> Pose:
    """Perform the routine "dance"."""
    return perform("dance", skeleton, times, scale)


def perform(routine: Routine, skeleton: Skeleton, times: Float[np.ndarray, "frame"], scale: float = 1.0) -> Pose:
    """Make poses at any times (seconds), with a leading frame axis; joint angles stay inside the skeleton's limits.

    "dance" steps in place, "crossing arms" sweeps both forearms before the torso, "bending arm" bends and stretches one
    arm. `scale` multiplies every amplitude, 1 giving up to about 2.5 m/s at the dancer's hands. The lowest point of
    the feet is on y = 0 at every instant. Raises `InputError` for an unknown routine.
    """
    if routine not in _ROUTINES:
        raise InputError(f"routine is {routine!r}; choose one of {', '.join(_ROUTINES)}.")
    times = np.asarray(times, float)
    swings, steps = _ROUTINES[routine]
    vectors = np.zeros((len(times), skeleton.num_dofs))
    column = {name: index for index, name in enumerate(skeleton.dof_names)}
    for name, (mean, waves) in swings.items():
        vectors[:, column[name]] = np.radians(mean + scale * _waves(waves, times))
    for name, waves in _SWAY.items():
        vectors[:, column[name]] = scale * _waves(waves, times)
    for prefix, phase in (("l_", 0.0), ("r_", 0.5)):
        lift = steps * np.maximum(0, np.sin(2 * np.pi * (STEP_RATE * times + phase))) ** 2
        highest = np.exp(-(((times - _KNEE_LIFT_TIME) / 0.32) ** 2)) * (prefix == "l_")
        vectors[:, column[prefix + "hip_flex"]] += np.radians(2 + scale * (30 + 28 * highest) * lift)
        vectors[:, column[prefix + "knee_flex"]] += np.radians(6 + scale * (44 + 28 * highest) * lift)
        vectors[:, column[prefix + "ankle_dorsi"]] += np.radians(4 - scale * 16 * lift)
    poses = [_standing(skeleton, vector) for vector in jnp.asarray(vectors, jnp.float32)]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *poses)


def stand(skeleton: Skeleton, times: Float[np.ndarray, "frame"], sway: float, seed: int = 0) -> Pose:
    """Stand in the rest pose with feet planted and sway as people do, slowly and a little; a leading frame axis.

    The body turns about the ankles like an inverted pendulum, and trunk, head and arms drift. `sway`, metres, is about
    the standard deviation of the head's place over the `times` (seconds), whose mean pose is the pose at rest.
    """
    rng, heights = np.random.default_rng([seed, 7]), np.asarray(skeleton.landmarks)
    place = {name: heights[index] for index, name in enumerate(skeleton.landmark_names)}
    ankles = 0.5 * (place["l_ankle"] + place["r_ankle"])
    vectors = np.zeros((len(times), skeleton.num_dofs))
    for column, name in enumerate(skeleton.dof_names):
        share = _STANCE.get(name, _STANCE.get(name[2:], 0.0))
        if share:
            vectors[:, column] = sway / (place["head"] - ankles)[1] * share * _drift(rng, np.asarray(times, float))
    turn = vectors[:, 3:6]
    vectors[:, :3] = np.cross(turn, place["pelvis"] - ankles)
    for side in ("l_", "r_"):
        vectors[:, skeleton.dof_names.index(side + "ankle_dorsi")] = turn[:, 0]
        vectors[:, skeleton.dof_names.index(side + "ankle_inv")] = turn[:, 2] * (1 if side == "l_" else -1)
    poses = [_pose(skeleton, vector) for vector in jnp.asarray(vectors, jnp.float32)]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *poses)


def _drift(rng: np.random.Generator, times: np.ndarray) -> np.ndarray:
    """Draw slow waves whose slower ones are larger; mean 0 and standard deviation 1 over the times."""
    waves = [(_SLOW / rate, rate, rng.uniform()) for rate in _SLOW * np.arange(1, 9) * rng.uniform(0.8, 1.2, 8)]
    drift = _waves(waves, times)
    drift = drift - drift.mean()
    return drift / max(float(drift.std()), 1e-9)


def ground_path(times: Float[np.ndarray, "frame"], scale: float = 1.0) -> Float[np.ndarray, "frame 3"]:
    """Tell where the actor stands: the root sway alone, on the ground."""
    times = np.asarray(times, float)
    sway = [scale * _waves(_SWAY[name], times) for name in ("root_tx", "root_tz")]
    return np.stack([sway[0], np.zeros_like(times), sway[1]], axis=1)


def recorded(motion: Motion, times: Float[np.ndarray, "frame"]) -> tuple[Pose, Float[np.ndarray, "frame 3"]]:
    """Take the poses of a motion at any times (seconds after its first frame), and where the actor then stands.

    The middle of its path is moved to the origin; the path is as of `ground_path`. Before its beginning and after its
    end the actor stands still.
    """
    motion = continuous(turned(motion, "y"))
    own = motion.timestamps - motion.timestamps[0]
    asked, back = np.unique(np.clip(times, own[0], own[-1]), return_inverse=True)
    found = at_times(motion, motion.timestamps[0] + asked)
    pelvis = found.joints[:, found.joint_names.index("pelvis")].astype(float)
    middle = 0.5 * (pelvis.min(axis=0) + pelvis.max(axis=0)) * [1, 0, 1]
    root = found.root.copy()
    root[:, :3, 3] -= middle
    path = (pelvis - middle) * [1, 0, 1]
    return Pose(jnp.asarray(root[back]), jnp.asarray(found.angles[back])), path[back]


def _waves(waves: list[tuple[float, float, float]], times: np.ndarray) -> np.ndarray:
    return sum(
        (amplitude * np.sin(2 * np.pi * (rate * times + phase)) for amplitude, rate, phase in waves),
        start=np.zeros_like(times),
    )


_pose = eqx.filter_jit(pose_from_vector)


@eqx.filter_jit
def _standing(skeleton: Skeleton, vector: Float[jax.Array, " dof"]) -> Pose:
    """Raise or lower a pose so that a flat foot stands on the ground.

    Where the weight goes over to the other foot, or only a toe or heel touches, it does within half a centimetre,
    smoothly.
    """
    feet = jnp.array([i for i, name in enumerate(skeleton.landmark_names) if name.endswith(("_toe", "_heel"))])
    pose = pose_from_vector(skeleton, vector)
    heights = landmark_positions(skeleton, pose)[feet, 1] - skeleton.landmarks[feet, 1]
    lowest = -_SOFTNESS * (jax.nn.logsumexp(-heights / _SOFTNESS) - jnp.log(4.0))
    return Pose(root=pose.root.at[1, 3].add(-lowest), angles=pose.angles)
