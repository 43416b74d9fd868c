"""The synthetic capture's own renderer: supersampled z-buffer, colours from the point of the skin, sun and sky."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from jaxmocap.geometry import unit_vectors, vertex_normals

from ._clothes import Subject
from ._draw_scene import GroundShadow, render_scene
from ._raster import visible_fragments
from ._scene import AMBIENT, DIRECT, SUN, Scene

_SHADOW_TEXEL = 0.02


@dataclass(frozen=True)
class Rendered:
    """A drawn view.

    Attributes:
        light: linear RGB before the sensor.
        ids: the actor's face at each pixel centre, -1 elsewhere.
    """

    light: Float[np.ndarray, "height width 3"]
    ids: Int[np.ndarray, "height width"]

    @property
    def mask(self) -> Bool[np.ndarray, "height width"]:
        return self.ids >= 0


def render_view(
    scene: Scene,
    subject: Subject,
    vertices: Float[np.ndarray, "vertex 3"],
    intrinsics: Float[np.ndarray, "3 3"],
    cam_from_world: Float[np.ndarray, "4 4"],
    size: tuple[int, int],
    supersampling: int = 2,
    bystanders: Sequence[tuple[Subject, Float[np.ndarray, "vertex 3"]]] = (),
) -> Rendered:
    """Draw the actor with its `vertices` in the world (metres) into the scene; `size` is (width, height).

    `bystanders` are others with theirs.
    """
    fine_size = (size[0] * supersampling, size[1] * supersampling)
    fine = intrinsics * np.array([[supersampling], [supersampling], [1.0]])
    shadow = ground_shadow(*_together([(subject, vertices), *bystanders]))
    light, inverse_depth = render_scene(scene, fine, cam_from_world, fine_size, shadow)
    for other, place in bystanders:
        _add(light, inverse_depth, other, place, fine, cam_from_world)
    behind_actor = inverse_depth.copy()
    _add(light, inverse_depth, subject, vertices, fine, cam_from_world)
    light = cv2.resize(light, size, interpolation=cv2.INTER_AREA)
    ids = np.full(size[0] * size[1], -1, np.int32)
    centres = visible_fragments(_in_camera(vertices, cam_from_world), subject.faces, intrinsics, size)
    x, y = centres.index % size[0], centres.index // size[0]
    middle = supersampling // 2
    behind = behind_actor[y * supersampling + middle, x * supersampling + middle]
    shown = centres.inverse_depth > behind
    ids[centres.index[shown]] = centres.face[shown]
    return Rendered(light, ids.reshape(size[1], size[0]))


def _in_camera(vertices: np.ndarray, cam_from_world: np.ndarray) -> np.ndarray:
    return vertices @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]


def _together(people: Sequence[tuple[Subject, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Join meshes: vertices and faces."""
    starts = np.cumsum([0] + [len(vertices) for _, vertices in people])
    faces = [subject.faces + start for (subject, _), start in zip(people, starts[:-1], strict=True)]
    return np.concatenate([vertices for _, vertices in people]), np.concatenate(faces)


def _add(
    light: np.ndarray,
    inverse_depth: np.ndarray,
    subject: Subject,
    vertices: np.ndarray,
    intrinsics: np.ndarray,
    cam_from_world: np.ndarray,
) -> None:
    """Draw a person into a picture, where nothing nearer is."""
    size = (light.shape[1], light.shape[0])
    fragments = visible_fragments(_in_camera(vertices, cam_from_world), subject.faces, intrinsics, size)
    front = fragments.inverse_depth > inverse_depth.reshape(-1)[fragments.index]
    rest = fragments.interpolate(subject.faces, subject.rest)[front]
    normals = fragments.interpolate(subject.faces, vertex_normals(vertices, subject.faces))[front]
    pixels = fragments.index[front]
    light.reshape(-1, 3)[pixels] = subject.outfit.colours(rest) ** 2 * illumination(normals)[:, None]
    inverse_depth.reshape(-1)[pixels] = fragments.inverse_depth[front]


def develop(
    light: Float[np.ndarray, "height width 3"], rng: np.random.Generator, gain: float = 1.0, noise: float = 0.006
) -> UInt8[np.ndarray, "height width 3"]:
    """Turn light into an image as a sensor does: gain, square-root response, and noise.

    The standard deviation of the noise is `noise` of full scale at mid grey and more in shadows.
    """
    values = np.sqrt(np.clip(np.float32(gain) * light, 0, 1))
    grain = rng.standard_normal(values.shape, dtype=np.float32)
    values = values + np.float32(noise) * grain * (np.float32(1.4) - values)
    return np.rint(255 * np.clip(values, 0, 1)).astype(np.uint8)


def film(
    draw: Callable[[int, int], Rendered],
    num_frames: int,
    num_cameras: int,
    sub_frames: int,
    seed: int,
    sensor_noise: float,
    illumination_change: float,
) -> tuple[UInt8[np.ndarray, "frame camera height width 3"], Bool[np.ndarray, "frame camera height width"]]:
    """Film images and masks with `draw(camera, instant)`.

    A frame's instants are its own time and then, if there are several sub-frames, those the image is the mean of.
    """
    images, masks = [], []
    for frame in range(num_frames):
        gain = 1 + illumination_change * np.sin(2 * np.pi * frame / max(num_frames, 2))
        for camera in range(num_cameras):
            first = frame * (1 + sub_frames)
            drawn = draw(camera, first)
            masks.append(drawn.mask)
            light = drawn.light
            if sub_frames > 1:
                light = np.mean([draw(camera, first + 1 + k).light for k in range(sub_frames)], axis=0)
            rng = np.random.default_rng([seed, 4, camera, frame])
            images.append(develop(light, rng, gain, sensor_noise))
    shape = (num_frames, num_cameras, *masks[0].shape)
    return np.stack(images).reshape(*shape, 3), np.stack(masks).reshape(shape)


def illumination(normals: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point"]:
    """Light normals by Lambert's law under the sun, plus a sky that is brighter above than the ground is below."""
    normals = unit_vectors(normals)
    return (AMBIENT * (0.85 + 0.25 * normals[:, 1]) + DIRECT * np.maximum(0, normals @ SUN)).astype(np.float32)


def ground_shadow(vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]) -> GroundShadow:
    """Cast the actor's soft shadow on y = 0.

    Every triangle is carried along the sun's rays; right under what is close to the ground there is a contact shadow.
    """
    height = np.maximum(vertices[:, 1], 0)
    cast = (vertices - height[:, None] / SUN[1] * SUN)[:, [0, 2]]
    low = cast.min(axis=0) - 0.3
    columns, rows = np.ceil((cast.max(axis=0) + 0.3 - low) / _SHADOW_TEXEL).astype(int)
    lit = _turned_up(cast, faces)
    sun = _fill(cast[faces[lit]], np.ones(lit.sum()), low, (rows, columns))
    near = np.maximum(0, 1 - height[faces].max(axis=1) / 0.16)
    order = np.flatnonzero(near)[np.argsort(near[near > 0])]
    contact = _fill(vertices[:, [0, 2]][faces[order]], near[order], low, (rows, columns))
    dark = np.maximum(cv2.GaussianBlur(sun, (0, 0), 1.4), 1.5 * cv2.GaussianBlur(contact, (0, 0), 2.5))
    return GroundShadow(np.minimum(dark, 1), (float(low[0]), float(low[1])), _SHADOW_TEXEL)


def _turned_up(ground: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (ground[faces[:, i]] for i in range(3))
    return (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0


def _fill(triangles: np.ndarray, values: np.ndarray, low: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Draw triangles (n, 3, 2) in metres in order into a map, each with its value."""
    image = np.zeros(shape, np.float32)
    fixed = np.rint(16 * ((triangles - low) / _SHADOW_TEXEL - 0.5)).astype(np.int32)
    for triangle, value in zip(fixed, values, strict=True):
        cv2.fillConvexPoly(image, triangle, float(value), shift=4)
    return image
