"""The actor: a mesh bound to a skeleton (Sec. 3.1), and the same with fewer faces."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from jaxtyping import Array, Float, Int, UInt8
from scipy.spatial import KDTree

from ._dof_table import Arm
from ._map_joints import Source
from ._read_skin import RawSkin
from ._skeleton import Skeleton


def _scalar(value: float | Array) -> Array:
    return jnp.asarray(value, float)


class Character(eqx.Module):
    """A closed triangle mesh in its rest pose, with its skeleton and dense skinning weights whose rows sum to 1.

    `misfit` is how far its joints are from the person's, metres along each axis, standard deviation: 0 of a scan, more
    of a body made to measure.
    """

    name: str = eqx.field(static=True)
    skeleton: Skeleton
    vertices: Float[Array, "vertex 3"]
    faces: Int[Array, "face 3"]
    weights: Float[Array, "vertex bone"]
    misfit: Float[Array, ""] = eqx.field(default=0.0, converter=_scalar)

    @classmethod
    def load(
        cls, path: str | Path, mapping: str | Path | Mapping[str, str] | None = None, arm: Arm = "cmu7"
    ) -> "Character":
        """Read a skinned glTF or GLB file of a person, or an SMPL, SMPL-H or SMPL-X model that you have, as .npz.

        The file's joints are recognised by name (Mixamo, VRM, Rocketbox, MakeHuman, Unreal, SMPL and similar) and,
        where names fail, by place; `mapping` (file joint name -> one of our body names; a JSON or TOML file or a dict)
        overrides both. Any rest pose, orientation and joint count will do; of a body model the mean shape is taken, or
        that of `betas` in the file. The result is in metres in the rest frame x = subject's left, y up, z forward.
        Raises `InputError` for anything that makes the file unusable.
        """
        from ._load import load_character

        return load_character(cls, Path(path), mapping, arm)

    @classmethod
    def from_mesh(
        cls,
        name: str,
        vertices: Float[np.ndarray, "vertex 3"],
        faces: Int[np.ndarray, "face 3"],
        weights: Float[np.ndarray, "vertex bone"],
        joints: Mapping[str, Float[np.ndarray, "3"]],
        arm: Arm = "cmu7",
    ) -> "Character":
        """Bind a clean mesh in the rest frame (metres) by weights (V, 18) to the skeleton of its `joints`.

        `joints` is as in `build_skeleton`; nose, toes, heels and the like are read off the mesh where not given.
        """
        from ._load import character_from_mesh

        return character_from_mesh(cls, name, vertices, faces, weights, joints, arm)

    @classmethod
    def from_skin(
        cls, name: str, source: Source, raw: RawSkin, mapping: Mapping[str, str] | None = None, arm: Arm = "cmu7"
    ) -> "Character":
        """Bring a skinned mesh with whatever joints, in metres, to ours, as `load` does with those in files.

        `source` says what is wrong with it, in an `InputError`.
        """
        from ._load import character_from_skin

        return character_from_skin(cls, name, source, raw, mapping, arm)

    def save_glb(self, path: str | Path, colours: UInt8[np.ndarray, "vertex 3"] | None = None) -> Path:
        """Write an ordinary skinned GLB, which `load` reads back to the same character; returns the path.

        `colours`, sRGB, of the vertices are for viewers and go into exports; tracking learns its own.
        """
        from ._save_glb import save_glb

        return save_glb(self, Path(path), colours)


def dominant_bodies(character: Character) -> Int[np.ndarray, "face"]:
    """Find the body that moves each face most."""
    return np.asarray(character.weights)[np.asarray(character.faces)].sum(1).argmax(1)


_NEIGHBOURS = 3


def simplify(character: Character, num_faces: int) -> tuple[Character, Int[np.ndarray, "face"]]:
    """Simplify a character to about `num_faces` faces and map every original face to the nearest new one (host).

    Quadric edge collapse (Garland and Heckbert 1997); a new vertex takes its weights from the three nearest old ones,
    by inverse distance. The skeleton is the same. A mesh that has no more faces than that is returned as it is.
    """
    vertices, faces = np.asarray(character.vertices), np.asarray(character.faces)
    if len(faces) <= num_faces:
        return character, np.arange(len(faces))
    mesh = trimesh.Trimesh(vertices, faces, process=False).simplify_quadric_decimation(face_count=num_faces)
    points, triangles = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)
    distance, index = KDTree(vertices).query(points, k=_NEIGHBOURS)
    share = 1.0 / np.maximum(distance, 1e-6)
    share /= share.sum(1, keepdims=True)
    weights = np.einsum("vk,vkb->vb", share, np.asarray(character.weights)[index]).astype(np.float32)
    _, nearest = KDTree(points[triangles].mean(1)).query(vertices[faces].mean(1))
    simple = replace(
        character,
        vertices=jax.device_put(points),
        faces=jax.device_put(triangles),
        weights=jax.device_put(weights),
    )
    return simple, np.asarray(nearest)


FACES_STEP, VERTICES_STEP = 256, 128
"""Meshes are filled up to multiples of these."""


def filled_up(character: Character) -> Character:
    """Fill the mesh up to a round number of faces and vertices, so that like meshes share their programs (host).

    The vertices are copies of the one that the root moves most, and the faces have no area there, so that the surface
    and the room that it takes stay as they are.
    """
    vertices, faces, weights = (np.asarray(leaf) for leaf in (character.vertices, character.faces, character.weights))
    more_faces, more_vertices = -len(faces) % FACES_STEP, -len(vertices) % VERTICES_STEP
    if more_faces == more_vertices == 0:
        return character
    copied = int(weights[:, 0].argmax())
    return replace(
        character,
        vertices=jax.device_put(np.concatenate([vertices, np.repeat(vertices[copied][None], more_vertices, axis=0)])),
        faces=jax.device_put(np.concatenate([faces, np.full((more_faces, 3), copied, faces.dtype)])),
        weights=jax.device_put(np.concatenate([weights, np.repeat(weights[copied][None], more_vertices, axis=0)])),
    )
