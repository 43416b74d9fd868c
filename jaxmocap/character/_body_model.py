"""Body model files of the SMPL family that the user has: SMPL, SMPL-H and SMPL-X as NumPy archives.

None is shipped or downloaded; they come under their own licences. Only plain arrays are read, never a pickle.
"""

import zipfile
from pathlib import Path
from typing import NoReturn

import numpy as np

from jaxmocap._results import InputError

from ._read_skin import RawSkin

_BODY = (
    *("Pelvis", "L_Hip", "R_Hip", "Spine1", "L_Knee", "R_Knee", "Spine2", "L_Ankle", "R_Ankle", "Spine3", "L_Foot"),
    *("R_Foot", "Neck", "L_Collar", "R_Collar", "Head", "L_Shoulder", "R_Shoulder", "L_Elbow", "R_Elbow", "L_Wrist"),
    "R_Wrist",
)
_HANDS = tuple(f"{side}_Finger{number}" for side in "LR" for number in range(15))
_NAMES = {24: (*_BODY, "L_Hand", "R_Hand"), 52: _BODY + _HANDS, 55: (*_BODY, "Jaw", "L_Eye", "R_Eye", *_HANDS)}
_NEEDED = {"v_template": 2, "f": 2, "weights": 2, "J_regressor": 2, "kintree_table": 2}


class BodyModel:
    """An SMPL, SMPL-H or SMPL-X file in memory: its mean shape, or that of `betas` if the file holds some."""

    def __init__(self, path: Path):
        self.path = path
        if not path.is_file():
            raise InputError(f"{path} does not exist; give the path of an SMPL, SMPL-H or SMPL-X model as .npz.")
        arrays = self._arrays()
        vertices = arrays["v_template"].astype(np.float64)
        faces, weights = arrays["f"].astype(np.int64), arrays["weights"].astype(np.float64)
        regressor, tree = arrays["J_regressor"].astype(np.float64), arrays["kintree_table"].astype(np.int64)
        joints = len(regressor)
        if joints not in _NAMES:
            self.fail(f"has {joints} joints; SMPL has 24, SMPL-H 52 and SMPL-X 55")
        expected = {"v_template": (len(vertices), 3), "weights": (len(vertices), joints), "kintree_table": (2, joints)}
        expected |= {"J_regressor": (joints, len(vertices)), "f": (len(faces), 3)}
        for name, shape in expected.items():
            if arrays[name].shape != shape:
                self.fail(f"has {name} of shape {arrays[name].shape}, {shape} was expected; it is damaged")
        if len(faces) == 0 or faces.min() < 0 or faces.max() >= len(vertices):
            self.fail(f"has triangles that point past its {len(vertices)} vertices; it is damaged")
        parents = tuple(int(parent) if 0 <= parent < number else -1 for number, parent in enumerate(tree[0]))
        vertices = vertices + self._shape(arrays, len(vertices))
        self.raw = RawSkin(
            vertices=vertices,
            faces=faces,
            weights=weights,
            joint_names=_NAMES[joints],
            joint_parents=parents,
            joint_places=regressor @ vertices,
            extras={},
            joint_nodes=tuple(range(joints)),
            place=np.eye(4),
            inverse_binds=np.tile(np.eye(4), (joints, 1, 1)),
        )

    def fail(self, message: str) -> NoReturn:
        """Raise the one-sentence error of this file."""
        raise InputError(f"{self.path}: {message}.")

    def _arrays(self) -> dict[str, np.ndarray]:
        try:
            with np.load(self.path, allow_pickle=False) as file:
                missing = [name for name in _NEEDED if name not in file.files]
                if missing:
                    self.fail(
                        f"is no SMPL model, it lacks {', '.join(missing)}; a file such as SMPLX_NEUTRAL.npz is needed"
                    )
                wanted = [name for name in (*_NEEDED, "shapedirs", "betas") if name in file.files]
                arrays = {name: file[name] for name in wanted}
        except InputError:
            raise
        except (ValueError, OSError, zipfile.BadZipFile, EOFError, KeyError) as error:
            self.fail(
                f"cannot be read ({error}); a NumPy archive of plain arrays is needed, without pickled objects: save "
                "J_regressor as a dense array"
            )
        for name, axes in _NEEDED.items():
            if arrays[name].ndim != axes or arrays[name].dtype.kind not in "fiu":
                self.fail(f"has {name} that is no table of numbers; it is damaged")
        return arrays

    def _shape(self, arrays: dict[str, np.ndarray], count: int) -> np.ndarray:
        """Sum what the shape coefficients in the file add to the mean body."""
        if "betas" not in arrays:
            return np.zeros((count, 3))
        betas = arrays["betas"].astype(np.float64).ravel()
        directions = arrays.get("shapedirs")
        if directions is None or directions.ndim != 3 or directions.shape[:2] != (count, 3):
            self.fail("has betas but no shapedirs that fit its vertices; leave betas out for the mean shape")
        used = min(len(betas), directions.shape[2])
        return directions[:, :, :used].astype(np.float64) @ betas[:used]
