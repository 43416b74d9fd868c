"""Small captures with known content: frames carry their number, and a person of known size stands at the origin."""

import json
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

SIZE = (64, 48)
MATRIX = np.array([[60.0, 0, 32], [0, 60.0, 24], [0, 0, 1]])
# BODY_25, metres: x across, y up, standing 1.7 m tall at the origin
PERSON = np.array(
    [
        [0, 1.58, 0.1], [0, 1.42, 0], [-0.18, 1.4, 0], [-0.25, 1.13, 0], [-0.28, 0.9, 0.05],
        [0.18, 1.4, 0], [0.25, 1.13, 0], [0.28, 0.9, 0.05], [0, 0.92, 0], [-0.1, 0.92, 0],
        [-0.11, 0.5, 0.02], [-0.12, 0.09, 0], [0.1, 0.92, 0], [0.11, 0.5, 0.02], [0.12, 0.09, 0],
        [-0.03, 1.62, 0.08], [0.03, 1.62, 0.08], [-0.07, 1.6, 0], [0.07, 1.6, 0], [0.13, 0.02, 0.15],
        [0.17, 0.02, 0.13], [0.12, 0.03, -0.05], [-0.13, 0.02, 0.15], [-0.17, 0.02, 0.13], [-0.12, 0.03, -0.05],
    ]
)  # fmt: skip


def picture(number: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Eight blocks spell the number at the top; the bottom left quarter is red, the bottom right green."""
    width, height = size
    image = np.full((height, width, 3), 90, np.uint8)
    for bit in range(8):
        image[: height // 3, bit * width // 8 : (bit + 1) * width // 8] = 235 if number >> bit & 1 else 20
    image[height * 2 // 3 :, : width // 2] = (200, 30, 30)
    image[height * 2 // 3 :, width // 2 :] = (30, 160, 30)
    return image


def number_of(image: np.ndarray) -> int:
    height, width = image.shape[:2]
    centres = [(2 * bit + 1) * width // 16 for bit in range(8)]
    return sum(1 << bit for bit, x in enumerate(centres) if image[height // 6, x].mean() > 128)


def make_video(
    path: Path,
    count: int = 12,
    size: tuple[int, int] = SIZE,
    milliseconds: Sequence[int] | None = None,
    rotation: int = 0,
    first: int = 0,
    black: Sequence[int] = (),
    fps: int = 30,
    codec: str = "libx264",
    display: Sequence[int] | None = None,
) -> Path:
    """An H.264 video with B-frames and few key frames, at 30 frames per second or at the given times.

    `display` moves columns and rows: (column', row') = (column, row) @ [[a, b], [c, d]].
    """
    with av.open(str(path), "w") as container:
        stream = container.add_stream(
            codec, rate=fps, options={"crf": "12", "g": "8", "bf": "2"} if codec == "libx264" else {}
        )
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        unit = Fraction(1, fps) if path.suffix in (".avi", ".h264") else Fraction(1, 1000)
        stream.codec_context.time_base = stream.time_base = unit
        if rotation:
            stream.set_display_rotation(rotation)
        if display is not None:
            a, b, c, d = (value << 16 for value in display)
            stream.set_display_matrix([a, b, 0, c, d, 0, 0, 0, 1 << 30])
        times = [round(1000 * i / fps) for i in range(count)] if milliseconds is None else milliseconds
        for index, time in enumerate(times):
            image = picture(first + index, size) * (index not in black)
            frame = av.VideoFrame.from_ndarray(image.astype(np.uint8), format="rgb24")
            frame.pts, frame.time_base = round(time / 1000 / unit), unit
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def look_at_pose(angle: float, distance: float = 4.0, height: float = 1.0) -> np.ndarray:
    """cam_from_world of a camera `height` above the ground, `angle` degrees around the person, looking at it at 1 m."""
    a, tilt = np.radians(angle), np.arctan2(height - 1.0, distance)
    centre = np.array([distance * np.sin(a), height, distance * np.cos(a)])
    level = np.array([-np.sin(a), 0.0, -np.cos(a)])
    down = np.array([0.0, -1.0, 0.0])
    lower = np.cos(tilt) * down - np.sin(tilt) * level
    rotation = np.stack([np.cross(down, level), lower, np.cos(tilt) * level + np.sin(tilt) * down])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ centre
    return pose


def write_model(folder: Path, poses: dict[str, np.ndarray], count: int, first: int = 0, size: tuple[int, int] = SIZE):
    from scipy.spatial.transform import Rotation

    folder.mkdir(exist_ok=True)
    (folder / "cameras.txt").write_text(
        "# cameras\n" + "".join(f"{i + 1} PINHOLE {size[0]} {size[1]} 60 60 32 24\n" for i in range(len(poses)))
    )
    lines = []
    for index, (name, pose) in enumerate(poses.items()):
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        values = " ".join(map(repr, map(float, (w, x, y, z, *pose[:3, 3]))))
        for frame in range(first, first + count):
            lines.append(f"{len(lines) + 1} {values} {index + 1} {name}/{frame:05d}.png\n\n")
    (folder / "images.txt").write_text("".join(lines))
    (folder / "points3D.txt").write_text("")


def write_keypoints(file: Path, pose: np.ndarray, *others: np.ndarray, points: np.ndarray = PERSON) -> None:
    in_camera = points @ pose[:3, :3].T + pose[:3, 3]
    pixels = in_camera @ MATRIX.T
    person = np.concatenate([pixels[:, :2] / pixels[:, 2:], np.full((25, 1), 0.9)], axis=1)
    people = [{"pose_keypoints_2d": list(np.asarray(p, float).ravel())} for p in (*others, person)]
    file.write_text(json.dumps({"people": people}))


def write_mask(file: Path, size: tuple[int, int] = SIZE, value: int = 255) -> None:
    import cv2

    mask = np.zeros(size[::-1], np.uint8)
    mask[10:40, 25:40] = value
    cv2.imwrite(str(file), mask)


TOML = """name = "small"
fps = 30
frames = 12
units = "metres"
up = "y"
cameras = "cameras"
selected_frames = [0, 6]
keypoints = "keypoints"
masks = "masks"

[[camera]]
name = "cam0"
video = "cam0.mp4"

[[camera]]
name = "cam1"
video = "cam1.mp4"
"""
POSES = {"cam0": look_at_pose(-12.0), "cam1": look_at_pose(12.0)}


def edit_toml(folder: Path, old: str, new: str) -> None:
    """Replace a part of a capture's file, which must be there."""
    text = (folder / "capture.toml").read_text()
    assert old in text
    (folder / "capture.toml").write_text(text.replace(old, new))
