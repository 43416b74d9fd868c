"""MHR, the Momentum Human Rig (Ferguson et al. 2025): its skin, from tensor files that the user has downloaded.

Code and files are under Apache-2.0. Read are the plain arrays of MHR's portable files, version 1 (`rig.npz` and
`lod0.npz` to `lod6.npz`), in centimetres; neither its package nor PyTorch is needed, and nothing is downloaded.
"""

import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import NoReturn

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap._results import InputError
from jaxmocap.character import RawSkin

_WHERE = (
    "download mhr-assets-v1-common.zip and mhr-assets-v1-lod1.zip (Apache-2.0) from "
    "https://github.com/facebookresearch/MHR/releases, unpack both into one folder, and give it with --assets"
)
_LEVELS = tuple(f"lod{number}.npz" for number in (1, 2, 3, 4, 5, 6, 0))  # of detail, the one to take first
_SHAPES, _FARTHEST = 45, 5.0  # of the body, head and hands, without the face; standard deviations
_CENTIMETRE = 0.01
_RIG = {"joint_names": 1, "joint_parents": 1, "inverse_bind_pose": 2}
_MESH = {"base_shape": 2, "shape_vectors": 3, "faces": 2, "skin_indices": 2, "skin_weights": 2}


class Mhr:
    """A folder of MHR's tensor files."""

    def __init__(self, assets: str | Path | None):
        if assets is None:
            raise InputError(f"MHR is not shipped with us; {_WHERE}.")
        self.path = Path(assets)
        found = [name for name in _LEVELS if (self.path / name).is_file()]
        if not (self.path / "rig.npz").is_file() or not found:
            raise InputError(f"{self.path} does not hold MHR's rig.npz and one of lod0.npz to lod6.npz; {_WHERE}.")
        self._mesh = found[0]

    def fail(self, message: str) -> NoReturn:
        """Raise the one-sentence error of this folder."""
        raise InputError(f"{self.path}: MHR {message}.")

    def skin(self, parameters: Mapping[str, float]) -> RawSkin:
        """Make the rest pose with `parameters` "shape0" to "shape44", standard deviations from the mean.

        20 are of the body, 20 of the head and 5 of the hands. Joints do not move with them, as in MHR. Raises
        `InputError`.
        """
        rig, mesh = self._arrays("rig.npz", _RIG), self._arrays(self._mesh, _MESH)
        names = tuple(str(name) for name in rig["joint_names"])
        vertices, faces = mesh["base_shape"].astype(np.float64), mesh["faces"].astype(np.int64)
        joints, owners = len(names), mesh["skin_indices"].astype(np.int64)
        parents, bind = rig["joint_parents"].astype(np.int64), rig["inverse_bind_pose"].astype(np.float64)
        fits = parents.shape == (joints,) and bind.shape == (joints, 8) and faces.shape[1:] == (3,)
        fits = fits and vertices.shape[1:] == (3,) and mesh["shape_vectors"].shape[1:] == vertices.shape
        fits = fits and owners.shape == mesh["skin_weights"].shape and len(owners) == len(vertices)
        if not fits or not _within(faces, len(vertices)) or not _within(owners, joints) or np.any(bind[:, 7] <= 0):
            self.fail("files do not fit together; take rig.npz and the level of detail from one release")
        weights = np.zeros((len(vertices), joints))
        np.add.at(weights, (np.arange(len(vertices))[:, None], owners), mesh["skin_weights"].astype(np.float64))
        shapes = self._shapes(parameters, len(mesh["shape_vectors"]))
        for number, amount in shapes.items():
            vertices = vertices + amount * mesh["shape_vectors"][number]
        return RawSkin(
            vertices=_CENTIMETRE * vertices,
            faces=faces,
            weights=weights,
            joint_names=names,
            joint_parents=tuple(int(parent) if 0 <= parent < number else -1 for number, parent in enumerate(parents)),
            joint_places=_CENTIMETRE * _origins(bind),
            extras={},
            joint_nodes=tuple(range(joints)),
            place=np.eye(4),
            inverse_binds=np.tile(np.eye(4), (joints, 1, 1)),
        )

    def _arrays(self, name: str, needed: Mapping[str, int]) -> dict[str, np.ndarray]:
        try:
            with np.load(self.path / name, allow_pickle=False) as file:
                missing = [key for key in ("schema_version", *needed) if key not in file.files]
                if missing:
                    self.fail(f"has a {name} without {', '.join(missing)}; {_WHERE}")
                if int(file["schema_version"]) != 1:
                    self.fail(f"has a {name} of version {int(file['schema_version'])}; version 1 is known")
                arrays = {key: file[key] for key in needed}
        except InputError:
            raise
        except (ValueError, TypeError, OSError, zipfile.BadZipFile, EOFError, KeyError) as error:
            self.fail(f"has a {name} that cannot be read ({error}); download it again")
        for key, axes in needed.items():
            if arrays[key].ndim != axes or arrays[key].dtype.kind not in ("U" if key == "joint_names" else "fiu"):
                self.fail(f"has a {name} whose {key} is no such table; it is damaged, download it again")
            if arrays[key].dtype.kind == "f" and not np.all(np.isfinite(arrays[key])):
                self.fail(f"has a {name} whose {key} is not finite; it is damaged, download it again")
        return arrays

    def _shapes(self, parameters: Mapping[str, float], count: int) -> dict[int, float]:
        shapes = {}
        for name, value in parameters.items():
            found = re.fullmatch(r"shape(\d{1,2})", name)
            if found is None or int(found[1]) >= min(_SHAPES, count):
                raise InputError(f"{name!r} is no parameter of MHR; use shape0 to shape{min(_SHAPES, count) - 1}.")
            if not abs(value) <= _FARTHEST:
                raise InputError(f"MHR's parameter {name} is {value:g}; -{_FARTHEST:g} to {_FARTHEST:g} was expected.")
            shapes[int(found[1])] = float(value)
        return shapes


def _within(numbers: np.ndarray, count: int) -> bool:
    return numbers.size > 0 and int(numbers.min()) >= 0 and int(numbers.max()) < count


def _origins(bind: np.ndarray) -> np.ndarray:
    """Where the joints are, of transforms to their spaces: translation, quaternion (x, y, z, w) and scale."""
    turned = Rotation.from_quat(bind[:, 3:7]).inv().apply(bind[:, :3])
    return -turned / bind[:, 7:]
