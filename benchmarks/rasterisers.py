"""Scoring particles by Eqs 6 and 7 against hand-written C++, and drawing one body against the rasterisers people use.

    python benchmarks/rasterisers.py --out rasterisers.json

One core. All sides draw the same poses of the same mesh into the same rectangles, in turns within one run; times are
medians of process time, so that other programs on the machine disturb them little. Beside every time stands how well
the answers agree. The C++ looks at the smallest region that holds all particles. What is not installed is skipped with
a reason: a C++ compiler, embreex (`pip install embreex`), PyTorch3D.
"""

import argparse
import ctypes
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

os.environ["JAX_NUM_CPU_DEVICES"] = "1"
os.environ["NPROC"] = "1"  # XLA's own threads
os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + " --xla_cpu_multi_thread_eigen=false"

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from figures import Figure, add_options, finish, record
from scene import scene

from jaxmocap._runtime import quick_loops
from jaxmocap.character import Character, Pose, body_transforms, retract, skin
from jaxmocap.energies import (
    Base,
    BodyPart,
    GroupProblem,
    ModelView,
    Scores,
    SearchEnergy,
    base_buffers,
    body_part,
    prepare_base,
    score_particles,
    search_energy,
    uncovered_cost,
)
from jaxmocap.energies._view_view import ViewView, _meets
from jaxmocap.observation import FrameProblem
from jaxmocap.render import crop, face_ids

CAPACITY = 16384
EPSILON = 1e-3
AT_LEAST = 0.1  # seconds that are timed at once
GROUPS = ("root", "torso", "l_arm", "l_leg")


def median_ms(sides: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Median process time of a call of every side in milliseconds. The sides take turns, each with as many calls as
    fill `AT_LEAST`: some systems count the time of a process in steps of 4 ms."""
    times: dict[str, list[float]] = {name: [] for name in sides}
    calls = {}
    for name, call in sides.items():
        call()  # warms up
        begin = time.perf_counter()
        call()
        calls[name] = int(np.ceil(AT_LEAST / (time.perf_counter() - begin)))
    for _ in range(repeats):
        for name, call in sides.items():
            begin = time.process_time()
            for _ in range(calls[name]):
                call()
            times[name].append(1e3 * (time.process_time() - begin) / calls[name])
    return {name: float(np.median(taken)) for name, taken in times.items()}


def built() -> ctypes.CDLL | None:
    """`z_buffer.cpp`, compiled for this machine; None without a compiler."""
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        return None
    library = Path(tempfile.mkdtemp()) / "z_buffer.so"
    flags = ["-O3", "-march=native", "-ffast-math", "-fno-finite-math-only", "-std=c++17", "-shared", "-fPIC"]
    source = Path(__file__).with_name("z_buffer.cpp")
    subprocess.run([compiler, *flags, str(source), "-o", str(library)], check=True)
    return ctypes.CDLL(str(library))


class Region(NamedTuple):
    """Corners (row, column) of what the C++ looks at in the rectangle of each view, and its size."""

    corners: np.ndarray
    size: tuple[int, int]

    def cut(self, values: object, camera: int) -> np.ndarray:
        (top, left), (height, width) = self.corners[camera], self.size
        return np.asarray(values)[top : top + height, left : left + width]

    def mask(self, camera: int, size: tuple[int, int]) -> np.ndarray:
        inside = np.zeros(size, bool)
        self.cut(inside, camera)[:] = True
        return inside


class Case(NamedTuple):
    """Particles of one group in one frame, and the region that holds them all."""

    group: GroupProblem
    increments: np.ndarray
    region: Region


def region_of(
    character: Character, part: BodyPart, pose: Pose, problem: FrameProblem, increments: np.ndarray
) -> Region:
    """The smallest region, in steps of 16 pixels, that holds the part for all increments in both views."""
    height, width = problem.size
    if part.faces.shape[1] == part.num_faces:
        return Region(np.zeros((2, 2), int), problem.size)
    boxes = []
    for delta in increments:
        points = np.asarray(part.posed(character, retract(character.skeleton, pose, jnp.asarray(delta))))
        flat = np.einsum("cij,vj->cvi", np.asarray(problem.projection)[:, :, :3], points)
        flat += np.asarray(problem.projection)[:, None, :, 3]
        pixels = flat[..., :2] / flat[..., 2:] - np.asarray(problem.origins)[:, None, ::-1]
        boxes.append(np.concatenate([pixels.min(1), pixels.max(1)], -1))
    low, high = np.min(boxes, 0)[:, :2] - 4, np.max(boxes, 0)[:, 2:] + 4
    size = [min(int(-(-extent // 16) * 16), full) for extent, full in
            zip((high - low).max(0)[::-1], (height, width), strict=True)]  # fmt: skip
    corner = np.clip(low[:, ::-1], 0, [height - size[0], width - size[1]])
    return Region(corner.astype(int) // 8 * 8, (size[0] // 8 * 8, size[1] // 8 * 8))


def jax_scores(energy: SearchEnergy, case: Case, capacity: int = CAPACITY) -> tuple[Base, Callable[[], Scores]]:
    """What the particles share, and a call that scores them with room for `capacity` windows."""
    group, increments, _ = case

    as_tracked = partial(eqx.filter_jit, compiler_options=quick_loops())  # as `optimised_jit` compiles a search

    @as_tracked
    def prepared(group):
        return prepare_base(energy, group, CAPACITY)

    @as_tracked
    def scored(group, base, increments):
        return score_particles(energy, group, base, increments, capacity)

    base, rows = prepared(group), jnp.asarray(increments)
    return base, lambda: jax.block_until_ready(scored(group, base, rows))


class _Rectangle(ctypes.Structure):
    _fields_ = [(name, ctypes.c_int) for name in ("rows", "columns", "words")] + [
        (name, ctypes.c_void_p) for name in ("packed", "base_id", "origin", "corner", "near", "between")
    ]


class _Far(ctypes.Structure):
    _fields_ = [
        ("count", ctypes.c_int), ("target", ctypes.c_void_p), ("face", ctypes.c_void_p), ("cost", ctypes.c_void_p),
        ("fixed_cost", ctypes.c_float), ("fixed_count", ctypes.c_float),
    ]  # fmt: skip


def far_pixels(case: Case, base: Base, pair: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[float, float]]:
    """Pixels of one view outside its region whose partner in the other lies in the region there: where, which face, at
    what cost if they meet; and cost and number of those whose partner lies elsewhere too."""
    group, region, shared, term = case.group, case.region, base.prepared[1], ViewView()
    m, n, size = pair, 1 - pair, group.frame.size
    keys = crop(base.buffers)
    faces = np.asarray(group.layout.face(keys))
    rows, columns = jnp.meshgrid(*(jnp.arange(extent, dtype=jnp.float32) for extent in size), indexing="ij")
    between = jax.tree.map(lambda values: values[pair], shared.between)
    x, y, inside = term._partner(between, keys[m], rows, columns, m, n, group)
    column, row = (np.round(np.asarray(place)).astype(int) for place in (x, y))
    here = ~region.mask(m, size) & (faces[m] >= 0)
    there = region.mask(n, size)[row, column] & np.asarray(inside) & here
    corner = term._corner(n * size[0] * size[1], x, y, size[1], size[0])
    colour = term._colour_cost(shared.packed[m].reshape(size), shared.packed.reshape(-1), *corner, size[1])
    met = inside & _meets(group, jnp.maximum(faces[m], 0), keys[n][row, column])
    fixed = np.asarray(term._pixel_cost(colour, met, inside, here & ~there))
    top, left = region.corners[n]
    target = (row - top) * region.size[1] + column - left
    sums = float(np.maximum(fixed, 0).sum()), float((fixed >= 0).sum())
    return target[there], faces[m][there], np.asarray(colour)[there], sums


def c_scores(library: ctypes.CDLL, case: Case, base: Base) -> tuple[Callable[[bool], None], np.ndarray, np.ndarray]:
    """The same by `z_buffer.cpp`: a call, with Eq. 7 or without, and where it leaves the totals of both. `base` is what
    particles share for both equations."""
    group, increments, region = case
    character, part, pose, problem = group.character, group.part, group.pose, group.frame

    def plain(values, kind=np.float32) -> np.ndarray:
        return np.ascontiguousarray(np.asarray(values), kind)

    poses = [retract(character.skeleton, pose, jnp.asarray(delta)) for delta in increments]
    bones = plain([np.asarray(body_transforms(character.skeleton, moved))[:, :3] for moved in poses])
    weights = np.asarray(part.weights)
    index = np.argsort(-weights, 1)[:, :4]
    share = np.take_along_axis(weights, index, 1)
    buffers, _ = eqx.filter_jit(base_buffers)(group, CAPACITY)
    keys, layout = crop(buffers), part.layout
    ids = layout.face(keys)
    depth = jnp.stack([layout.inverse_depth(keys[c], problem.depth_range[c]) for c in range(2)])
    depth = jnp.where(ids >= 0, depth, 0.0)

    def cut(values) -> np.ndarray:
        return np.stack([region.cut(values[c], c) for c in range(2)])

    table = plain(problem.surface.colour_distance)
    arrays = (
        bones, plain(part.vertices), plain(index, np.int32), plain(share / share.sum(1, keepdims=True)),
        plain(part.faces.T, np.int32), plain(part.face_numbers, np.int32), plain(problem.projection),
        plain(problem.origins + region.corners, np.int32), plain(cut(problem.labels), np.int32),
        plain(cut(problem.background)), plain(cut(uncovered_cost(problem.background, EPSILON))), plain(cut(depth)),
        plain(cut(ids), np.int32), table,
    )  # fmt: skip
    sizes = (len(bones), bones.shape[1], len(part.vertices), part.faces.shape[1], 2, *region.size, *table.shape[1:])
    out, pairs, seen = np.zeros(len(bones)), np.zeros(len(bones)), np.zeros((2, *region.size), np.int32)
    shared = base.prepared[1]
    near = plain(problem.surface.near_faces, np.uint32)
    between = np.concatenate([shared.between.homography, shared.between.epipole[..., None]], -1)
    whole = (
        plain(shared.packed, np.int32), plain(ids, np.int32), plain(problem.origins, np.int32),
        plain(region.corners, np.int32), near, plain(between),
    )  # fmt: skip
    rectangle = _Rectangle(*problem.size, near.shape[1], *(array.ctypes.data for array in whole))
    far, kept = (_Far * 2)(), []
    for pair in range(2):
        target, face, cost, fixed = far_pixels(case, base, pair)
        lists = (plain(target, np.int32), plain(face, np.int32), plain(cost))
        far[pair] = _Far(len(target), *(array.ctypes.data for array in lists), *fixed)
        kept.append(lists)

    def call(with_views: bool, alive: object = (whole, kept)) -> None:  # the lists live as long as the call
        pointers = [ctypes.c_void_p(array.ctypes.data) for array in arrays]
        views = ctypes.byref(rectangle) if with_views else None
        library.score(
            *map(ctypes.c_int, sizes), *pointers, ctypes.c_float(EPSILON), ctypes.c_void_p(out.ctypes.data),
            ctypes.c_void_p(seen.ctypes.data), views, far, ctypes.c_void_p(pairs.ctypes.data),
        )  # fmt: skip

    return call, out, pairs


def against_cpp(library: ctypes.CDLL, repeats: int, particles: int) -> list[Figure]:
    """Milliseconds per render, ratio, and the largest difference of the energies, for every kind of group."""
    character, pose, problem = scene()
    figures = []
    eq6, both = SearchEnergy((ModelView(outside=0.0),)), search_energy()
    for name in GROUPS:
        dofs = character.skeleton.group(name)
        part = body_part(character, dofs)
        increments = np.zeros((particles, 39), np.float32)
        spread = np.where(np.array(dofs) < 3, 0.02, 0.05)
        increments[:, list(dofs)] = np.random.default_rng(0).normal(0, spread, (particles, len(dofs)))
        region = region_of(character, part, pose, problem, increments)
        case = Case(GroupProblem(character, part, pose, problem), increments, region)
        capacity = 2 ** int(np.ceil(np.log2(1.2 * int(jax_scores(eq6, case)[1]().needed))))
        base, ours = jax_scores(eq6, case, capacity)
        shared, with_views = jax_scores(both, case, capacity)
        theirs, totals, pairs = c_scores(library, case, shared)
        sides = {"jax": ours, "cpp": lambda: theirs(False), "both": with_views, "cpp both": lambda: theirs(True)}  # noqa: B023
        taken = median_ms(sides, repeats)
        scores, means = ours(), np.asarray(with_views().terms)[:, 1]
        assert int(scores.needed) <= capacity
        mine = np.asarray(scores.total) * float(problem.area)
        costs = ModelView().pixel_costs(crop(base.buffers), problem, part.layout)
        hand = totals + sum(float(costs[c].sum() - region.cut(costs[c], c).sum()) for c in range(2))
        renders = particles * problem.num_cameras
        label = f"{name} {region.size[1]}x{region.size[0]}"
        figures += [
            record(f"Eq. 6, {label}, this", taken["jax"] / renders, "ms per render", 0.5),
            record(f"Eq. 6, {label}, C++", taken["cpp"] / renders, "ms per render", 0.5),
            record(f"Eq. 6, {label}, this / C++", taken["jax"] / taken["cpp"], "", 0.3),
            record(f"Eq. 6, {label}, largest difference", float(np.abs(mine / hand - 1).max()), "of the energy", 1.0),
            record(f"Eq. 6 + 7, {label}, this", taken["both"] / renders, "ms per render", 0.5),
            record(f"Eq. 6 + 7, {label}, C++", taken["cpp both"] / renders, "ms per render", 0.5),
            record(f"Eq. 6 + 7, {label}, this / C++", taken["both"] / taken["cpp both"], "", 0.3),
            record(f"Eq. 7, {label}, largest difference", float(np.abs(means / pairs - 1).max()), "of the energy", 1.0),
        ]
    return figures


def embree(vertices: np.ndarray, faces: np.ndarray, problem: FrameProblem) -> Callable[[], np.ndarray] | None:
    """The nearest face along the ray of every pixel of the first view; None without embreex."""
    try:
        import trimesh
        from trimesh.ray.ray_pyembree import RayMeshIntersector
    except ImportError:
        return None
    height, width = problem.size
    row, column = np.mgrid[0:height, 0:width]
    origin = np.asarray(problem.origins[0])
    pixel = np.stack([column + origin[1] + 0.5, row + origin[0] + 0.5, np.ones_like(row)], -1).reshape(-1, 3)
    pose = np.asarray(problem.cam_from_world[0], np.float64)
    ways = pixel @ np.linalg.inv(np.asarray(problem.intrinsics[0], np.float64)).T @ pose[:3, :3]
    eye = np.broadcast_to(-pose[:3, :3].T @ pose[:3, 3], ways.shape)

    def draw() -> np.ndarray:
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        return RayMeshIntersector(mesh).intersects_first(eye, ways).reshape(height, width)

    return draw


def painter(vertices: np.ndarray, faces: np.ndarray, problem: FrameProblem) -> Callable[[], np.ndarray]:
    """Front faces filled one over the other from far to near by OpenCV."""
    height, width = problem.size
    projection, origin = np.asarray(problem.projection[0], np.float64), np.asarray(problem.origins[0])

    def draw() -> np.ndarray:
        flat = vertices @ projection[:, :3].T + projection[:, 3]
        pixels = flat[:, :2] / flat[:, 2:] - origin[::-1] - 0.5
        a, b, c = (pixels[faces[:, k]] for k in range(3))
        front = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0
        order = np.flatnonzero(front)[np.argsort(-flat[faces[front], 2].mean(1))]
        picture = np.full((height, width), -1, np.int32)
        corners = np.round(pixels[faces] * 16).astype(np.int32)
        for face in order:
            cv2.fillConvexPoly(picture, corners[face], int(face), shift=4)
        return picture

    return draw


def pytorch3d(vertices: np.ndarray, faces: np.ndarray, problem: FrameProblem) -> Callable[[], np.ndarray] | None:
    """PyTorch3D's rasteriser on the CPU; None where it is not installed."""
    try:
        import torch
        from pytorch3d.renderer.mesh.rasterize_meshes import rasterize_meshes
        from pytorch3d.structures import Meshes
    except ImportError:
        return None
    height, width = problem.size
    projection, origin = np.asarray(problem.projection[0], np.float64), np.asarray(problem.origins[0])
    flat = vertices @ projection[:, :3].T + projection[:, 3]
    pixels = flat[:, :2] / flat[:, 2:] - origin[::-1]
    short = min(height, width)
    unit = np.concatenate([(np.array([width, height]) - 2 * pixels) / short, flat[:, 2:]], 1)
    meshes = Meshes([torch.tensor(unit, dtype=torch.float32)], [torch.tensor(faces)])

    def draw() -> np.ndarray:
        found = rasterize_meshes(meshes, (height, width), 0.0, 1, bin_size=0, cull_backfaces=False)[0]
        return found[0, ..., 0].numpy()

    return draw


def against_rasterisers(repeats: int) -> list[Figure]:
    """Milliseconds for one body in one view, and the share of covered pixels that show another face."""
    character, pose, problem = scene()
    vertices, faces = np.asarray(skin(character, pose), np.float64), np.asarray(character.faces)
    view = (problem.intrinsics[:1], problem.cam_from_world[:1], problem.origins[:1])
    points = jnp.asarray(vertices, jnp.float32)
    ours = lambda: np.asarray(face_ids(points, character.faces, *view, *problem.size)[0][0])  # noqa: E731
    found = {"embreex": embree(vertices, faces, problem), "PyTorch3D": pytorch3d(vertices, faces, problem)}
    peers = {"OpenCV painter": painter(vertices, faces, problem)}
    for name, peer in found.items():
        if peer is None:
            print(f"{name} is skipped: it is not installed", file=sys.stderr)
        else:
            peers[name] = peer
    taken = median_ms({"this": ours, **peers}, repeats)
    ids = ours()
    covered = max(int((ids >= 0).sum()), 1)
    figures = [record("one body, this", taken["this"], "ms", 0.5)]
    for name, peer in peers.items():
        figures += [
            record(f"one body, {name}", taken[name], "ms", 1.0),
            record(f"one body, {name} / this", taken[name] / taken["this"], "", 0.5, "higher"),
            record(f"one body, {name}, other face", 100 * float((peer() != ids).sum()) / covered, "% of covered", 1.0),
        ]
    return figures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--particles", type=int, default=48)
    add_options(parser)
    options = parser.parse_args()
    figures = against_rasterisers(options.repeats)
    library = built()
    if library is None:
        print("C++ is skipped: there is no g++ or clang++", file=sys.stderr)
    else:
        figures += against_cpp(library, options.repeats, options.particles)
    return finish(figures, options)


if __name__ == "__main__":
    sys.exit(main())
