"""A motion on disk: `motion.npz`, which holds what was found, and `report.json`, which is for people.

The seconds that a run took are in `report.json` alone: the same run gives the same `motion.npz`, byte for byte.

`motion.npz`, schema version 1. No pickles: `numpy.load(path, allow_pickle=False)` reads all of it. Axes are T frames,
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

import contextlib
import json
import os
import tokenize
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxmocap._files import atomic_path, json_text, npz_bytes, plain
from jaxmocap._results import InputError
from jaxmocap.camera import Cameras
from jaxmocap.character import ROOT_DOFS, Character, Skeleton, capsules, known_dofs, search_hints

from ._motion import Motion

SCHEMA_VERSION = 1
_WALL_CLOCK = ("seconds", "seconds_per_frame")
"""Parts of the provenance that another run of the same would not have."""
_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    ValueError,
    EOFError,
    OSError,
    NotImplementedError,
    MemoryError,
    SyntaxError,  # these two: numpy parses the header of an array before it compares the checksum
    tokenize.TokenError,
)


def save(motion: Motion, folder: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write both files; `motion.npz` last, so that it never stands beside an older report."""
    folder = Path(folder)
    path = folder / "motion.npz"
    if path.exists() and not overwrite:
        raise InputError(
            f"The folder {folder} already holds the result of another run; choose another, delete it, or say "
            "overwrite=True."
        )
    created = not folder.exists()
    data, report = npz_bytes(_arrays(motion)), json_text(_report(motion))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as data_file, atomic_path(folder / "report.json") as report_file:
            data_file.write_bytes(data)
            report_file.write_text(report, encoding="utf-8")
    except OSError as error:
        if created:
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise InputError(f"The result cannot be written to {folder} ({error.strerror or error}).") from error
    return folder


def load(folder: str | os.PathLike[str]) -> Motion:
    """Read `motion.npz`, and from `report.json` beside it, where there is one, how long the run took."""
    path = Path(folder)
    if path.suffix != ".npz":
        path = path / "motion.npz"
    if not path.is_file():
        raise InputError(f"{folder} is not a result: there is no {path.name} in it; give the folder that track wrote.")
    arrays = read_npz(path)
    version = arrays.get("schema_version")
    if version is None or version.shape != () or version.dtype.kind not in "iu":
        raise InputError(f"{path} is not a motion of ours: it has no schema_version.")
    if version > SCHEMA_VERSION:
        raise InputError(
            f"{path} has schema version {int(version)}, this jaxmocap reads up to {SCHEMA_VERSION}; upgrade jaxmocap."
        )
    try:
        motion = _motion(arrays)
        return replace(motion, provenance={**motion.provenance, **_wall_clock(path.with_name("report.json"))})
    except KeyError as error:
        raise InputError(f"{path} lacks the array {error.args[0]!r}; write the result again.") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (ValueError, TypeError, IndexError) as error:
        raise InputError(f"{path} is damaged ({error}); write the result again.") from error


def _wall_clock(report: Path) -> dict[str, Any]:
    """Read the seconds in a report, if it can be read: nothing else depends on them."""
    try:
        found = json.loads(report.read_text(encoding="utf-8"))
        found = {**found, **found.get("provenance", {})}
    except (OSError, ValueError, TypeError, AttributeError, RecursionError):
        return {}
    return {name: found[name] for name in _WALL_CLOCK if name in found}


def read_npz(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """Read all arrays of an npz file, without pickles.

    Raises `InputError` if it is missing, damaged, or not an npz.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"The file {path} does not exist.")
    try:
        with path.open("rb") as file:
            archive = np.load(file, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise InputError(f"{path} is not an npz file; it holds a single array.")
            return {name: archive[name] for name in archive.files}
    except InputError:
        raise
    except _DAMAGE as error:
        raise InputError(
            f"{path} cannot be read as an npz file ({error}); it is damaged or of another kind."
        ) from error


def _arrays(motion: Motion) -> dict[str, np.ndarray]:
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
    lasting = {name: value for name, value in motion.provenance.items() if name not in _WALL_CLOCK}
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


def _motion(arrays: dict[str, np.ndarray]) -> Motion:
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


def _report(motion: Motion) -> dict[str, Any]:
    """Everything but the numbers of the motion itself: how it was made, and a verdict per frame."""
    verdicts = [
        {
            "frame": int(frame),
            "timestamp": float(motion.timestamps[index]),
            "status": str(motion.status[index]),
            "confidence": float(motion.confidence[index].mean()),
            "energy": {name: float(values[index]) for name, values in motion.energy.items()},
        }
        for index, frame in enumerate(motion.frames)
    ]
    counts = {f"{name}_frames": int((motion.status == name).sum()) for name in ("doubtful", "lost")}
    summary = {"schema_version": SCHEMA_VERSION, "character": motion.character.name, "frames": len(motion)}
    return {**summary, **counts, "provenance": motion.provenance, "verdicts": verdicts}


def _words(values: np.ndarray) -> tuple[str, ...]:
    return tuple(str(value) for value in values)


def _integers(values: np.ndarray) -> tuple[int, ...]:
    return tuple(int(value) for value in values)
