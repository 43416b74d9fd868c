"""A motion as the named arrays of `motion.npz`.

Schema version 1. No pickles: `numpy.load(path, allow_pickle=False)` reads all of it. Axes are T frames,
D degrees of freedom, the last A of them joint angles, J joints, B bodies (a person: 39, 33 and 18), C cameras. Metres,
radians, seconds, pixels.

    schema_version ()            int, 1
    pose (T, D), dof_names (D,)  translation of the pelvis, world rotation vector about it, joint angles
    root (T, 4, 4)               world_from_body; the identity is the rest pose
    angles (T, A)                joint angles, the last A of dof_names
    joints (T, J, 3)             world positions; joint_names (J,)
    frames (T,), timestamps (T,) frame numbers of the first camera's video and their times
    status (T,)                  "ok", "doubtful" or "lost";      confidence (T, J) in [0, 1]
    energy_terms (E,)            names; each is an array energy_<name> (T,), NaN where not evaluated
    covariance (T, J, 3, 3)      of each joint's place in the world, square metres; only where it is known
    character_name (), vertices (V, 3), faces (F, 3), weights (V, B)                        the mesh at rest, Eq. 1
    misfit ()                    of the character's joints, metres
    body_names, body_parents (B,), dof_body, dof_lower, dof_upper (A,), dof_axes, dof_origins (A, 3)
    group_names (G,), group_sizes (G,), group_dofs (sum of sizes,)                          degrees of freedom by limb
    dof_spread (D,), distal_dofs, posture_dofs                                              how a search treats them
    landmark_bodies (J,), landmarks (J, 3)                                                  at rest
    capsules (B, 7)              per body the ends of a segment and a radius around it, at rest; made of the mesh
    up (), provenance ()         "x", "y" or "z"; a JSON text
    camera_names (C,), camera_sizes (C, 2), camera_intrinsics (C, 3, 3), camera_distortion (C, 5),
    cam_from_world (C, T, 4, 4)  only where the cameras are known
"""

import json
from typing import Any

import jax
import numpy as np

from jaxmocap._files import plain
from jaxmocap._results import InputError
from jaxmocap.camera import Cameras
from jaxmocap.character import ROOT_DOFS, Character, Skeleton, capsules, known_dofs, search_hints

from ._motion import Motion

SCHEMA_VERSION = 1
WALL_CLOCK = ("seconds", "seconds_per_frame")
"""Parts of the provenance that another run of the same would not have."""


def motion_arrays(motion: Motion) -> dict[str, np.ndarray]:
    """Name the arrays that hold a motion."""
    character, skeleton = motion.character, motion.character.skeleton
    names = ("root", "angles", "joints", "frames", "timestamps", "status", "confidence")
    arrays: dict[str, Any] = {"schema_version": np.int64(SCHEMA_VERSION)}
    arrays |= {name: getattr(motion, name) for name in names}
    arrays |= {"pose": motion.pose_vectors, "dof_names": skeleton.dof_names, "joint_names": skeleton.landmark_names}
    arrays |= {"energy_terms": np.array(list(motion.energy), dtype=np.str_)}
    arrays |= {f"energy_{name}": values for name, values in motion.energy.items()}
    arrays |= {"character_name": character.name, "vertices": character.vertices, "faces": character.faces}
    arrays |= {
        "weights": character.weights,
        "misfit": character.misfit,
        "body_names": skeleton.body_names,
        "body_parents": skeleton.parents,
    }
    arrays |= {"dof_body": skeleton.dof_body, "dof_axes": skeleton.axes, "dof_origins": skeleton.origins}
    arrays |= {"dof_lower": skeleton.lower, "dof_upper": skeleton.upper}
    arrays |= {"group_names": [name for name, _ in skeleton.groups]}
    arrays |= {"group_sizes": [len(dofs) for _, dofs in skeleton.groups]}
    arrays |= {"group_dofs": [dof for _, dofs in skeleton.groups for dof in dofs]}
    arrays |= {"dof_spread": skeleton.dof_spread}
    arrays |= {"distal_dofs": np.array(skeleton.distal, int), "posture_dofs": np.array(skeleton.posture, int)}
    arrays |= {"landmark_bodies": skeleton.landmark_bodies, "landmarks": skeleton.landmarks}
    starts, ends, radii = capsules(character)
    arrays |= {"capsules": np.hstack([starts, ends, radii[:, None]]).astype(np.float32)}
    lasting = {name: value for name, value in motion.provenance.items() if name not in WALL_CLOCK}
    arrays |= {"up": motion.up, "provenance": json.dumps(plain(lasting), sort_keys=True, allow_nan=False)}
    if motion.covariance is not None:
        arrays["covariance"] = motion.covariance
    if motion.cameras is not None:
        cameras = motion.cameras
        arrays |= {
            "camera_names": cameras.names,
            "camera_sizes": cameras.sizes,
            "cam_from_world": cameras.cam_from_world,
        }
        arrays |= {"camera_intrinsics": cameras.intrinsics, "camera_distortion": cameras.distortion}
    return {name: np.asarray(values) for name, values in arrays.items()}


def motion_of(arrays: dict[str, np.ndarray]) -> Motion:
    """Make the motion that such arrays hold.

    Raises `KeyError` where one is missing, and `InputError` or another `ValueError`, `TypeError` or `IndexError` where
    one is not as it should be.
    """
    arrays = {"misfit": np.zeros((), np.float32), **arrays}  # which older results do not hold
    sizes = [int(size) for size in arrays["group_sizes"]]
    starts = np.cumsum([0, *sizes])
    dofs = _integers(arrays["group_dofs"])
    names = _words(arrays["dof_names"])
    if "dof_spread" in arrays:
        hints: dict[str, Any] = {"dof_spread": tuple(float(value) for value in arrays["dof_spread"])}
        hints |= {name: _integers(arrays[f"{name}_dofs"]) for name in ("distal", "posture")}
    else:  # written when every skeleton was that of a person
        hints = search_hints(known_dofs(names[ROOT_DOFS:]))
    skeleton = Skeleton(
        body_names=_words(arrays["body_names"]),
        parents=_integers(arrays["body_parents"]),
        dof_names=names,
        dof_body=_integers(arrays["dof_body"]),
        axes=jax.device_put(arrays["dof_axes"]),
        origins=jax.device_put(arrays["dof_origins"]),
        lower=jax.device_put(arrays["dof_lower"]),
        upper=jax.device_put(arrays["dof_upper"]),
        groups=tuple(
            (name, dofs[start : start + size])
            for name, start, size in zip(_words(arrays["group_names"]), starts, sizes, strict=False)
        ),
        **hints,
        landmark_names=_words(arrays["joint_names"]),
        landmark_bodies=_integers(arrays["landmark_bodies"]),
        landmarks=jax.device_put(arrays["landmarks"]),
    )
    character = Character(
        name=str(arrays["character_name"]),
        skeleton=skeleton,
        vertices=jax.device_put(arrays["vertices"]),
        faces=jax.device_put(arrays["faces"]),
        weights=jax.device_put(arrays["weights"]),
        misfit=jax.device_put(arrays["misfit"]),
    )
    _check_character(arrays)
    cameras = None
    if "camera_names" in arrays:
        cameras = Cameras(
            names=_words(arrays["camera_names"]),
            sizes=tuple((int(width), int(height)) for width, height in arrays["camera_sizes"]),
            intrinsics=jax.device_put(arrays["camera_intrinsics"]),
            distortion=jax.device_put(arrays["camera_distortion"]),
            cam_from_world=jax.device_put(arrays["cam_from_world"]),
        )
    return Motion(
        character=character,
        root=arrays["root"],
        angles=arrays["angles"],
        frames=arrays["frames"],
        timestamps=arrays["timestamps"],
        joints=arrays["joints"],
        confidence=arrays["confidence"],
        status=arrays["status"],
        energy={name: arrays[f"energy_{name}"] for name in _words(arrays["energy_terms"])},
        covariance=arrays.get("covariance"),
        provenance=json.loads(str(arrays["provenance"])),
        cameras=cameras,
        up=str(arrays["up"]),
    )


def _check_character(arrays: dict[str, np.ndarray]) -> None:
    bodies, dofs, joints = len(arrays["body_names"]), len(arrays["dof_body"]), len(arrays["joint_names"])
    vertices, faces = len(arrays["vertices"]), len(arrays["faces"])
    expected = {"vertices": (vertices, 3), "faces": (faces, 3), "weights": (vertices, bodies)}
    expected |= {"body_parents": (bodies,), "dof_axes": (dofs, 3), "dof_origins": (dofs, 3)}
    expected |= {"dof_lower": (dofs,), "dof_upper": (dofs,), "dof_names": (dofs + ROOT_DOFS,)}
    expected |= {"landmark_bodies": (joints,), "landmarks": (joints, 3), "misfit": ()}
    for name, shape in expected.items():
        if arrays[name].shape != shape:
            raise InputError(f"{name} has shape {arrays[name].shape}; {shape} was expected.")
    for name in ("vertices", "weights", "misfit", "dof_axes", "dof_origins", "dof_lower", "dof_upper", "landmarks"):
        if not np.isfinite(arrays[name]).all():
            raise InputError(f"{name} holds a number that is not finite.")
    parents = arrays["body_parents"]
    limits = {"faces": vertices, "dof_body": bodies, "landmark_bodies": bodies, "group_dofs": dofs + ROOT_DOFS}
    for name, limit in limits.items():
        if arrays[name].size and not (arrays[name].min() >= 0 and arrays[name].max() < limit):
            raise InputError(f"{name} points outside 0..{limit - 1}.")
    if not (parents < np.arange(bodies)).all() or parents[0] != -1:
        raise InputError("body_parents is not a tree with parents before children.")


def _words(values: np.ndarray) -> tuple[str, ...]:
    return tuple(str(value) for value in values)


def _integers(values: np.ndarray) -> tuple[int, ...]:
    return tuple(int(value) for value in values)
