"""A result as a picture or as a video that goes once round it, drawn on the host: no browser, no graphics card."""

import os
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from jaxmocap._files import write_bytes
from jaxmocap._results import InputError
from jaxmocap.capture import Capture
from jaxmocap.character import dominant_bodies
from jaxmocap.motion import Motion

from ._first_view import FIELD_OF_VIEW, Eye, distance_from, first_view
from ._limb_trust import STATUS_COLOURS, faces_by_status, words_about
from ._overlay import face_colours, paint_face_ids, to_pixels, write_words
from ._shown import Shown, gather
from ._video import write_overlay_video

_SIZE = (960, 720)
_FINER = 2  # times that many pixels are painted, and averaged
_TURN = 6.0  # seconds that one turn takes at least
_AIR = 1.05  # times as far away as the body would just fit
_SKY, _FLOOR, _LINES, _CAMERA = (238, 241, 245), (222, 226, 230), (196, 202, 208), (70, 74, 80)
_SHADOW = 0.72  # of the floor's brightness
_SUN = np.array([0.25, 1.0, 0.15])  # from where the shadow falls, y up
_OTHER = (170, 120, 230)
_LOST_OPACITY = 0.5
_CELL = 0.5  # metres


def write_movie(
    result: Motion | str | os.PathLike[str],
    path: str | os.PathLike[str],
    *,
    other: Motion | str | os.PathLike[str] | None = None,
    capture: Capture | str | os.PathLike[str] | None = None,
) -> Path:
    """Write a result as `.mp4`, a turn round the person while the clip plays, or as `.png`, the viewer's first view.

    The body's parts have the viewer's colours: blue as found, orange doubtful, red and see-through lost or hidden. A
    clip shorter than six seconds plays until the turn is done. `other` is a second result of the same frames, drawn
    violet and 1.5 metres beside. Raises `InputError` for another suffix and for a file that is there already.
    """
    path = Path(path)
    if path.suffix.lower() not in (".mp4", ".png"):
        raise InputError(f"{path} is no movie's name; one in .mp4, or in .png for a picture, was expected.")
    if path.exists():
        raise InputError(f"{path} exists already; choose a new name.")
    shown = gather(result, other, capture=capture)
    if path.suffix.lower() == ".mp4":
        return write_overlay_video(path, turntable(shown))
    done, data = cv2.imencode(".png", draw_scene(shown, 0, _first(shown))[..., ::-1])
    assert done
    write_bytes(path, data.tobytes())
    return path


def turntable(shown: Shown) -> Iterator[tuple[float, UInt8[np.ndarray, "height width 3"]]]:
    """Yield `(seconds, RGB picture)`: the clip, over and over until one turn is done, from an eye that goes round."""
    for seconds, index, eye in eyes(shown):
        yield seconds, draw_scene(shown, index, eye)


def eyes(shown: Shown) -> list[tuple[float, int, Eye]]:
    """List seconds, position of the motion and eye of each picture of one turn, on a circle round the clip's middle.

    The circle is a twentieth larger than the smallest one from which every picture holds all vertices of its frame.
    """
    times = shown.motion.timestamps - shown.motion.timestamps[0]
    step = float(np.median(np.diff(times))) if len(times) > 1 else 1 / 30
    length = float(times[-1]) + step
    rounds = max(int(np.ceil(_TURN / length - 1e-9)), 1)
    moments = [(float(moment) + number * length, i) for number in range(rounds) for i, moment in enumerate(times)]
    people, _, axis = _scene(shown)
    aspect, first = _SIZE[0] / _SIZE[1], _first(shown)
    view = first_view(people, np.zeros((0, 5, 3)), axis, aspect)
    away, begin = view.position - view.target, np.delete(first.position - first.target, axis)
    away, start = away / np.linalg.norm(away), np.arctan2(begin[1], begin[0])

    def eye_at(seconds: float, distance: float) -> Eye:
        angle = start + 2 * np.pi * seconds / (rounds * length)
        sides = np.linalg.norm(np.delete(away, axis)) * np.array([np.cos(angle), np.sin(angle)])
        return Eye(view.target + distance * np.insert(sides, axis, away[axis]), view.target, view.up)

    distance = 0.0
    for index in range(len(times)):
        points = _bodies(shown, index)[0]
        for seconds, _ in moments[index :: len(times)]:
            distance = max(distance, distance_from(points, eye_at(seconds, 1.0), FIELD_OF_VIEW, aspect))
    return [(seconds, index, eye_at(seconds, _AIR * distance)) for seconds, index in moments]


def draw_scene(shown: Shown, index: int, eye: Eye) -> UInt8[np.ndarray, "height width 3"]:
    """Draw the bodies with their shadow, the ground and the cameras at one position as seen from an eye."""
    width, height = _FINER * _SIZE[0], _FINER * _SIZE[1]
    focal = height / (2 * np.tan(FIELD_OF_VIEW / 2))
    intrinsics, pose = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]), eye.cam_from_world()
    picture = np.full((height, width, 3), _SKY, np.uint8)
    vertices, faces, colours, lost = _bodies(shown, index)
    _draw_ground(picture, shown, vertices, faces, intrinsics, pose)
    depth = float((pose[:3, :3] @ shown.people.mean(axis=0) + pose[:3, 3])[2])
    frusta = [shown.frustum(view, index) for view in range(len(shown.camera_names))]
    near = [float(to_pixels(corners, intrinsics, pose)[1].mean()) < depth for corners in frusta]
    for corners, before in zip(frusta, near, strict=True):
        if not before:
            _draw_frustum(picture, corners, intrinsics, pose)
    shaded = face_colours(vertices, faces, pose, (255, 255, 255)) / 255.0 * colours
    seen = paint_face_ids(vertices, faces, intrinsics, pose, (width, height))
    solid = paint_face_ids(vertices, faces[~lost], intrinsics, pose, (width, height)) if lost.any() else seen
    covered = solid >= 0
    picture[covered] = shaded[~lost][solid[covered]]
    through = (seen >= 0) & lost[np.maximum(seen, 0)]
    ink = _LOST_OPACITY * shaded[seen[through]] + (1 - _LOST_OPACITY) * picture[through]
    picture[through] = np.round(ink).astype(np.uint8)
    for corners, before in zip(frusta, near, strict=True):
        if before:
            _draw_frustum(picture, corners, intrinsics, pose)
    small = cv2.resize(picture, _SIZE, interpolation=cv2.INTER_AREA)
    motion = shown.motion
    words = f"frame {motion.frames[index]}  {motion.timestamps[index]:.2f} s  {words_about(motion, index)}"
    write_words(small, words, (16, 32), 0.6, (255, 255, 255))
    return small


def _scene(shown: Shown) -> tuple[np.ndarray, np.ndarray, int]:
    """Return the scene that is to be framed, with room for a second result beside the first."""
    people, frusta, axis = shown.scene(0)
    if shown.other is not None:
        people = np.concatenate([people, people + shown.aside()])
    return people, frusta, axis


def _first(shown: Shown) -> Eye:
    people, frusta, axis = _scene(shown)
    return first_view(people, frusta, axis, _SIZE[0] / _SIZE[1])


def _bodies(shown: Shown, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Gather vertices, faces, the colour of each face and which are lost, of one result or of two side by side."""
    motion = shown.motion
    vertices, faces = motion.vertices(index), np.asarray(motion.character.faces)
    status = faces_by_status(motion, index, dominant_bodies(motion.character))
    colours = sum(np.outer(marked, STATUS_COLOURS[name]) for name, marked in status.items())
    place = shown.other_at(index)
    if place is None or shown.other is None:
        return vertices, faces, np.asarray(colours), status["lost"]
    beside = shown.other.vertices(place) + shown.aside()
    theirs = np.asarray(shown.other.character.faces)
    return (
        np.concatenate([vertices, beside]),
        np.concatenate([faces, theirs + len(vertices)]),
        np.concatenate([np.asarray(colours), np.tile(_OTHER, (len(theirs), 1))]),
        np.concatenate([status["lost"], np.zeros(len(theirs), bool)]),
    )


def _draw_ground(
    picture: np.ndarray, shown: Shown, vertices: np.ndarray, faces: np.ndarray, intrinsics: np.ndarray, pose: np.ndarray
) -> None:
    """Paint a floor under everything with a grid of half metres, and the shadow of the bodies on it."""
    people, frusta, axis = _scene(shown)
    points = np.delete(np.concatenate([people, frusta.reshape(-1, 3)]), axis, axis=1)
    low, high = np.floor(points.min(axis=0) / _CELL - 2) * _CELL, np.ceil(points.max(axis=0) / _CELL + 2) * _CELL
    lift = lambda flat: np.insert(np.asarray(flat, float), axis, shown.ground, axis=1)  # noqa: E731
    corners = lift([low, [high[0], low[1]], high, [low[0], high[1]]])
    _fill(picture, _seen(corners, intrinsics, pose), _FLOOR)
    for side in range(2):
        for value in np.arange(low[side], high[side] + _CELL / 2, _CELL):
            ends = np.array([low, high])
            ends[:, side] = value
            _draw_line(picture, lift(ends), intrinsics, pose, _LINES)
    sun = np.roll(_SUN, (axis - 1) % 3)
    rise = np.maximum(vertices[:, axis] - shown.ground, 0.0)
    fallen = vertices - rise[:, None] * sun / sun[axis]
    fallen[:, axis] = shown.ground
    shadow = paint_face_ids(fallen, faces, intrinsics, pose, (picture.shape[1], picture.shape[0])) >= 0
    if not shadow.any():
        return
    blur, (rows, columns) = 2.5 * _FINER, (np.flatnonzero(shadow.any(axis=side)) for side in (1, 0))
    around = round(3 * blur)
    window = np.s_[max(rows[0] - around, 0) : rows[-1] + around, max(columns[0] - around, 0) : columns[-1] + around]
    soft = cv2.GaussianBlur(shadow[window].astype(np.float32), (0, 0), blur)
    picture[window] = np.round(picture[window] * (1 - (1 - _SHADOW) * soft[..., None])).astype(np.uint8)


def _draw_frustum(picture: np.ndarray, corners: np.ndarray, intrinsics: np.ndarray, pose: np.ndarray) -> None:
    for start, end in ((0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1)):
        _draw_line(picture, corners[[start, end]], intrinsics, pose, _CAMERA, 2 * _FINER)


def _draw_line(
    picture: np.ndarray,
    ends: Float[np.ndarray, "2 3"],
    intrinsics: np.ndarray,
    pose: np.ndarray,
    ink: tuple[int, int, int],
    width: int = _FINER,
) -> None:
    pixels = _seen(ends, intrinsics, pose)
    if len(pixels) == 2:
        cv2.line(picture, pixels[0].tolist(), pixels[1].tolist(), ink, width, cv2.LINE_AA)


def _fill(picture: np.ndarray, pixels: np.ndarray, ink: tuple[int, int, int]) -> None:
    if len(pixels) > 2:
        cv2.fillPoly(picture, [pixels.astype(np.int32)], ink, cv2.LINE_AA)


def _seen(points: np.ndarray, intrinsics: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Project a line or a convex polygon, cut at a plane before the eye, to whole pixels; empty where it is behind."""
    near, seen = 0.1, points @ pose[:3, :3].T + pose[:3, 3]
    kept = []
    for number, (here, after) in enumerate(zip(seen, np.roll(seen, -1, axis=0), strict=True)):
        if here[2] >= near:
            kept.append(here)
        back = len(points) == 2 and number == 1  # a line has one edge, not two
        if (here[2] >= near) != (after[2] >= near) and not back:
            kept.append(here + (near - here[2]) / (after[2] - here[2]) * (after - here))
    if not kept:
        return np.zeros((0, 2), int)
    pixels = np.array(kept) @ intrinsics.T
    return np.clip(np.round(pixels[:, :2] / pixels[:, 2:]), -(2**15), 2**15).astype(int)
