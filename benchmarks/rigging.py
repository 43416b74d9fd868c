"""How well bare meshes are rigged: joints, folds of the skin, and processor time.

    python benchmarks/rigging.py [CHARACTER.glb ...] [--out FIGURES.json] [--gate BASELINE.json]

Every character, whose own joints are the truth, becomes bare meshes: as it is, turned in space and in millimetres,
with z up, mirrored, of 1,000 and 80,000 triangles, a fifth of its triangles missing, with 5 mm of noise, and standing
in a T-, an A- and a relaxed pose. Printed are the mean and the worst distance of 13 joints from their truth, and the
share of triangles that turn inside out at the worst limit of any joint. Without characters two built-in bodies are
used, whose like the fitting knows: flattering figures. Times are those of the second of two runs.
"""

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import trimesh
from figures import Figure, add_options, finish, record
from scipy.spatial.transform import Rotation

import jaxmocap as jm
from jaxmocap.character import angles_at_rest, landmark_positions, rest_pose, simplify, skin
from jaxmocap.rigging import turned_out

JOINTS = ("neck", *(f"{s}_{j}" for s in "lr" for j in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")))
STANCES = {  # degrees from the neutral body
    "T-pose": {"shoulder_flex": 0, "shoulder_abd": 0, "shoulder_axial": 0, "elbow_flex": 0},
    "A-pose": {"shoulder_flex": 0, "shoulder_abd": -45, "shoulder_axial": 0, "elbow_flex": 5},
    "relaxed pose": {"shoulder_flex": 5, "shoulder_abd": -72, "shoulder_axial": 0, "elbow_flex": 15, "hip_abd": 3},
}


class Bare(NamedTuple):
    """A mesh, where its joints are (in its own units and axes), and into how many triangles it is to be made."""

    vertices: np.ndarray
    faces: np.ndarray
    joints: dict[str, np.ndarray]
    num_faces: int = 5000

    def turned(self, matrix: np.ndarray) -> "Bare":
        there = {joint: matrix @ place for joint, place in self.joints.items()}
        return self._replace(vertices=self.vertices @ matrix.T, joints=there)


def posed(character: jm.Character, angles: dict[str, float] | None) -> Bare:
    """The character at rest, or with some joint angles in degrees from the neutral body."""
    skeleton = character.skeleton
    pose, at_rest = rest_pose(skeleton), np.degrees(angles_at_rest(skeleton))
    if angles is not None:
        turned = [angles[n[2:]] - at_rest[k] if n[2:] in angles else 0.0 for k, n in enumerate(skeleton.dof_names[6:])]
        pose = jm.Pose(jnp.eye(4), jnp.asarray(np.radians(turned), jnp.float32))
    places = dict(zip(skeleton.landmark_names, np.asarray(landmark_positions(skeleton, pose), float), strict=True))
    joints = {joint: places[joint] for joint in JOINTS}
    return Bare(np.asarray(skin(character, pose), float), np.asarray(character.faces), joints)


def variants(character: jm.Character) -> Iterator[tuple[str, Bare]]:
    plain, draw = posed(character, None), np.random.default_rng(0)
    yield "as it is", plain
    yield "turned, millimetres", plain.turned(1000 * Rotation.from_euler("xyz", [40, 70, -130], True).as_matrix())
    yield "z up", plain.turned(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]))
    mirrored = plain.turned(np.diag([-1.0, 1, 1]))  # the other's left is this one's right
    swap = {"l_": "r_", "r_": "l_"}
    yield (
        "mirrored",
        mirrored._replace(joints={swap.get(j[:2], j[:2]) + j[2:]: p for j, p in mirrored.joints.items()}),
    )
    yield "1,000 triangles", plain._replace(num_faces=1000)
    fine = trimesh.Trimesh(plain.vertices, plain.faces, process=False).subdivide().subdivide()
    yield "80,000 triangles", Bare(np.asarray(fine.vertices), np.asarray(fine.faces), plain.joints, 80_000)
    yield "a fifth missing", plain._replace(faces=plain.faces[draw.random(len(plain.faces)) > 0.2])
    yield "5 mm of noise", plain._replace(vertices=plain.vertices + draw.normal(scale=0.005, size=plain.vertices.shape))
    for stance, angles in STANCES.items():
        yield stance, posed(character, angles)


def quality(name: str, character: jm.Character) -> list[Figure]:
    figures = []
    for variant, bare in variants(character):
        rigged = jm.rig((bare.vertices, bare.faces), num_faces=bare.num_faces)
        matrix, skeleton = rigged.rest_from_file, rigged.character.skeleton
        there = {joint: matrix[:3, :3] @ place + matrix[:3, 3] for joint, place in bare.joints.items()}
        off = [100 * float(np.linalg.norm(np.asarray(skeleton.landmark(joint)) - there[joint])) for joint in there]
        folds = 100 * turned_out(rigged.character)
        figures.append(record(f"{name}, {variant}: joints, mean", float(np.mean(off)), "cm", 0.1))
        figures.append(record(f"{name}, {variant}: joints, worst", max(off), "cm", 0.2))
        figures.append(record(f"{name}, {variant}: turned out at the worst limit", folds, "%", 0.25))
    return figures


def seconds(character: jm.Character, num_faces: int) -> float:
    """Processor time to rig a mesh of so many triangles into 5,000."""
    halvings = max(0, round(np.log2(num_faces / 5000) / 2))
    simple, _ = simplify(character, num_faces // 4**halvings)
    mesh = trimesh.Trimesh(np.asarray(simple.vertices, float), np.asarray(simple.faces), process=False)
    for _ in range(halvings):
        mesh = mesh.subdivide()
    begin = 0.0
    for _ in range(2):  # the first one compiles
        begin = time.process_time()
        jm.rig((np.asarray(mesh.vertices), np.asarray(mesh.faces)))
    return time.process_time() - begin


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("characters", type=Path, nargs="*", help="skinned GLB files with good joints")
    add_options(parser)
    options = parser.parse_args()
    characters = {f"{path.parent.name}/{path.stem}": jm.Character.load(path) for path in options.characters}
    if not characters:
        stout = jm.body(1.9, {"thigh": 1.08, "upper_arm": 0.94}, {"torso": 1.16, "thigh": 1.1})
        slim = jm.body(1.5, {"shank": 0.94, "torso": 1.05}, {"torso": 0.89, "upper_arm": 0.9})
        characters = {"stout": stout, "slim": slim}
    figures = [figure for name, character in characters.items() for figure in quality(name, character)]
    one = next(iter(characters.values()))
    for count in (5_000, 500_000):
        figures.append(record(f"processor time, {count:,} triangles", seconds(one, count), "s", 0.5))
    return finish(figures, options)


if __name__ == "__main__":
    raise SystemExit(main())
