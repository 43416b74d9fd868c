"""Drawn over an image: the tracked body as a shaded, half transparent mesh with contour, skeleton and verdict; a mask.

Which face is seen in each pixel is found by the painter's algorithm on the host: quick, and good enough to look at.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from jaxmocap._results import InputError
from jaxmocap._shapes import check_shape

_NEAR = 0.05  # metres before the camera; nearer points are not drawn
_SHIFT = 4  # fractional bits of OpenCV's drawing coordinates
_LIGHT = np.array([-0.35, -0.6, -0.72])  # towards the light, in the camera's frame: from above, behind the camera
_AMBIENT = 0.35
_COLOURS = {"ok": (70, 170, 255), "doubtful": (255, 160, 30), "lost": (235, 60, 60)}
_CONTOUR = (255, 255, 255)
_MASK_OUTLINE = (255, 230, 40)
_SURE, _UNSURE = np.array([60.0, 230.0, 110.0]), np.array([255.0, 60.0, 50.0])
_SPINE = (("pelvis", "spine"), ("spine", "thorax"), ("thorax", "neck"), ("neck", "head"), ("head", "nose"))
_ARM = (("neck", "l_shoulder"), ("l_shoulder", "l_elbow"), ("l_elbow", "l_wrist"))
_LEG = (("pelvis", "l_hip"), ("l_hip", "l_knee"), ("l_knee", "l_ankle"), ("l_ankle", "l_toe"), ("l_ankle", "l_heel"))
_LEFT = _ARM + _LEG
_BONES = _SPINE + _LEFT + tuple((a.replace("l_", "r_"), b.replace("l_", "r_")) for a, b in _LEFT)


@dataclass(frozen=True)
class OverlayStyle:
    """How much of what is drawn.

    Attributes:
        opacity: of the mesh, 0 to 1.
        contour: width of the silhouette's outline, pixels; 0 leaves it out.
        bones: width of the skeleton's lines, pixels; 0 leaves it out.
        verdict: whether border and words tell the status and the label is written.
    """

    opacity: float = 0.55
    contour: int = 1
    bones: int = 2
    verdict: bool = True


def draw_overlay(
    image: UInt8[np.ndarray, "height width 3"],
    vertices: Float[np.ndarray, "vertex 3"],
    faces: Int[np.ndarray, "face 3"],
    intrinsics: Float[np.ndarray, "3 3"],
    cam_from_world: Float[np.ndarray, "4 4"],
    *,
    ids: Int[np.ndarray, "height width"] | None = None,
    joints: Float[np.ndarray, "joint 3"] | None = None,
    joint_names: Sequence[str] = (),
    confidence: Float[np.ndarray, " joint"] | None = None,
    status: str = "ok",
    label: str = "",
    style: OverlayStyle = OverlayStyle(),
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw the posed mesh and skeleton over a copy of an RGB image.

    `ids` are the face numbers seen per pixel (-1 where none), as `jaxmocap.render.face_ids` gives them; without, they
    are painted here. Mesh colour and frame border tell the `status`: blue "ok", orange "doubtful", red "lost", the last
    two also in words. Bones go from green (`confidence` 1) to red (0). `label` is written at the top left. Raises
    `InputError` for a picture that is none of 8-bit RGB.
    """
    check_shape("image", image, ("height", "width", 3), "RGB")
    if image.dtype != np.uint8:
        raise InputError(f"image has the type {image.dtype}; uint8 was expected: RGB from 0 to 255.")
    intrinsics, cam_from_world = np.asarray(intrinsics, np.float64), np.asarray(cam_from_world, np.float64)
    drawn = np.ascontiguousarray(image).copy()
    if ids is None:
        ids = paint_face_ids(vertices, faces, intrinsics, cam_from_world, (image.shape[1], image.shape[0]))
    _draw_mesh(drawn, np.asarray(ids), face_colours(vertices, faces, cam_from_world, _COLOURS[status]), style)
    if joints is not None and style.bones:
        _draw_bones(drawn, to_pixels(joints, intrinsics, cam_from_world)[0], joint_names, confidence, style.bones)
    if style.verdict:
        _draw_verdict(drawn, status, label)
    return drawn


def draw_mask(
    image: UInt8[np.ndarray, "height width 3"], mask: Bool[np.ndarray, "height width"]
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw a mask over a copy of an RGB image: half dark outside, with its outline."""
    drawn = np.where(mask[..., None], image, image // 2)
    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(drawn, outlines, -1, _MASK_OUTLINE, 1)
    return drawn


def jpeg_bytes(image: UInt8[np.ndarray, "height width 3"], quality: int = 85) -> bytes:
    """Encode an RGB picture as JPEG, for pages that hold their pictures."""
    done, data = cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality])
    assert done
    return data.tobytes()


def bone_indices(names: Sequence[str]) -> Int[np.ndarray, "bone 2"]:
    """List the pairs of joints that the drawn bones join, of those that have a name."""
    return np.array([[names.index(a), names.index(b)] for a, b in _BONES if a in names and b in names])


def contact_sheet(
    images: Sequence[UInt8[np.ndarray, "height width 3"]], columns: int, *, gap: int = 4
) -> UInt8[np.ndarray, "sheet_height sheet_width 3"]:
    """Lay images out on white, `columns` to a row. The cell is the largest image; smaller ones sit top left."""
    if not images or columns < 1:
        raise ValueError("a contact sheet needs at least one image and one column")
    columns = min(columns, len(images))
    height, width = max(image.shape[0] for image in images), max(image.shape[1] for image in images)
    rows = -(-len(images) // columns)
    sheet = np.full((rows * (height + gap) - gap, columns * (width + gap) - gap, 3), 255, np.uint8)
    for index, image in enumerate(images):
        top, left = index // columns * (height + gap), index % columns * (width + gap)
        sheet[top : top + image.shape[0], left : left + image.shape[1]] = image
    return sheet


def to_pixels(
    points: Float[np.ndarray, "point 3"],
    intrinsics: Float[np.ndarray, "3 3"],
    cam_from_world: Float[np.ndarray, "4 4"],
) -> tuple[Float[np.ndarray, "point 2"], Float[np.ndarray, " point"]]:
    """Project in NumPy: pixels (centre of the first at 0.5, NaN behind the camera) and depth, metres."""
    in_camera = np.asarray(points, np.float64) @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
    depth = in_camera[:, 2]
    safe = np.where(depth > _NEAR, depth, np.nan)
    return (in_camera @ intrinsics.T)[:, :2] / safe[:, None], depth


def paint_face_ids(
    vertices: Float[np.ndarray, "vertex 3"],
    faces: Int[np.ndarray, "face 3"],
    intrinsics: Float[np.ndarray, "3 3"],
    cam_from_world: Float[np.ndarray, "4 4"],
    size: tuple[int, int],
) -> Int[np.ndarray, "height width"]:
    """Paint faces from far to near: face numbers (-1 where empty) of an image of `size` (width, height).

    Faces that reach behind the camera are left out. Where faces of a surface interleave in depth the order of their
    centres decides; use `jaxmocap.render.face_ids` for exact visibility.
    """
    pixels, depth = to_pixels(vertices, intrinsics, cam_from_world)
    width, height = size
    corners = pixels[faces]
    low, high = corners.min(axis=1), corners.max(axis=1)  # NaN compares false below
    drawn = (high > 0).all(1) & (low < [width, height]).all(1)
    drawn &= (np.abs(corners) < 2**14).all(axis=(1, 2))
    order = np.flatnonzero(drawn)
    order = order[np.argsort(-depth[faces[order]].mean(axis=1), kind="stable")]
    # OpenCV fills a polygon and its outline, half a pixel too much all round; integer pixel centres, ours are at 0.5.
    quantised = np.round((corners[order] - 0.5) * (1 << _SHIFT)).astype(np.int32)
    ids = np.zeros((height, width), np.int32)
    for number, triangle in zip((order + 1).tolist(), quantised, strict=True):
        cv2.fillConvexPoly(ids, triangle, number, cv2.LINE_8, _SHIFT)
    return ids - 1


def face_colours(
    vertices: np.ndarray, faces: np.ndarray, cam_from_world: np.ndarray, colour: tuple[int, int, int]
) -> UInt8[np.ndarray, "face 3"]:
    """Shade every face by Lambert's cosine law, the same from both sides."""
    in_camera = np.asarray(vertices, np.float64) @ cam_from_world[:3, :3].T
    a, b, c = (in_camera[faces[:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.maximum(np.linalg.norm(normals, axis=1), 1e-12)
    light = _LIGHT / np.linalg.norm(_LIGHT)
    facing = np.where(np.einsum("fd,fd->f", normals, a + cam_from_world[:3, 3]) > 0, -1.0, 1.0)
    cosine = np.maximum(facing * (normals @ light) / lengths, 0.0)
    return np.round(np.outer(_AMBIENT + (1 - _AMBIENT) * cosine, colour)).astype(np.uint8)


def _draw_mesh(image: np.ndarray, ids: np.ndarray, colours: np.ndarray, style: OverlayStyle) -> None:
    covered = ids >= 0
    rows, columns = np.flatnonzero(covered.any(1)), np.flatnonzero(covered.any(0))
    if len(rows) == 0:
        return
    window = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    covered, part = np.ascontiguousarray(covered[window]), image[window]
    mixed = cv2.addWeighted(colours[np.maximum(ids[window], 0)], style.opacity, part, 1 - style.opacity, 0.0)
    np.copyto(part, mixed, where=covered[..., None])
    if style.contour:
        outlines, _ = cv2.findContours(covered.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        corner = (int(columns[0]), int(rows[0]))
        cv2.drawContours(image, outlines, -1, _CONTOUR, style.contour, cv2.LINE_8, offset=corner)


def _draw_bones(
    image: np.ndarray, pixels: np.ndarray, names: Sequence[str], confidence: np.ndarray | None, width: int
) -> None:
    index = {name: number for number, name in enumerate(names)}
    sure = np.ones(len(pixels)) if confidence is None else np.clip(np.asarray(confidence, np.float64), 0, 1)
    colours = sure[:, None] * _SURE + (1 - sure[:, None]) * _UNSURE
    points = np.round((pixels - 0.5) * 16)  # four fractional bits; OpenCV counts from the centre of the first pixel
    usable = np.all(np.isfinite(points) & (np.abs(points) < 2**19), axis=1)
    for start, end in _BONES:
        a, b = index.get(start), index.get(end)
        if a is None or b is None or not (usable[a] and usable[b]):
            continue
        colour = ((colours[a] + colours[b]) / 2).tolist()
        cv2.line(image, _pair(points[a]), _pair(points[b]), colour, width, cv2.LINE_AA, 4)
    for joint in {index[name] for bone in _BONES for name in bone if name in index}:
        if usable[joint]:
            cv2.circle(image, _pair(points[joint]), (width + 1) * 16, colours[joint].tolist(), -1, cv2.LINE_AA, 4)


def _draw_verdict(image: np.ndarray, status: str, label: str) -> None:
    height, width = image.shape[:2]
    scale = max(min(height, width) / 540, 0.4)
    margin = round(12 * scale)
    if label:
        write_words(image, label, (margin, margin + round(20 * scale)), 0.6 * scale, (255, 255, 255))
    if status != "ok":
        border = max(round((10 if status == "lost" else 5) * scale), 2)
        cv2.rectangle(image, (0, 0), (width - 1, height - 1), _COLOURS[status], 2 * border - 1)
        write_words(image, status.upper(), (margin, height - 2 * margin), 1.4 * scale, _COLOURS[status])


def write_words(
    image: UInt8[np.ndarray, "height width 3"],
    text: str,
    origin: tuple[int, int],
    scale: float,
    colour: tuple[int, int, int],
) -> None:
    """Write a line with a shadow into an image, its left foot at `origin`, pixels."""
    thickness = max(round(2 * scale), 1)
    for shift, ink in ((1, (0, 0, 0)), (0, colour)):  # the shadow keeps the text readable on a bright image
        place = (origin[0] + shift, origin[1] + shift)
        cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, scale, ink, thickness, cv2.LINE_AA)


def _pair(point: np.ndarray) -> tuple[int, int]:
    return int(point[0]), int(point[1])
