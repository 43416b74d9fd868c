"""A textured square filmed by moving cameras: small videos whose cameras are known to the last digit."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from moving_cameras import centres_of, look

SIZE = (480, 270)
FOCAL = 430.0
MATRIX = np.array([[FOCAL, 0.0, 240.0], [0.0, FOCAL, 135.0], [0.0, 0.0, 1.0]])
# origin, two unit edges: the ground, a wall behind, one on the left, and a box's front
PLANES = (
    ([-6.0, 0.0, -4.0], [1.0, 0, 0], [0, 0, 1.0], (12.0, 9.0)),
    ([-6.0, 0.0, -3.0], [1.0, 0, 0], [0, 1.0, 0], (12.0, 5.0)),
    ([-2.5, 0.0, -3.0], [0, 0, 1.0], [0, 1.0, 0], (6.0, 4.0)),
    ([0.8, 0.0, -1.0], [0.9, 0, 0.4], [0, 1.0, 0], (1.2, 1.1)),
)


def texture(seed: int) -> np.ndarray:
    """Grey noise at several scales, 64 texels a metre, repeating after 16 metres."""
    generator = np.random.default_rng(seed)
    picture = np.zeros((1024, 1024), np.float32)
    for cells in (32, 64, 128, 256, 512):
        noise = generator.normal(size=(cells, cells)).astype(np.float32)
        picture += cv2.resize(noise, (1024, 1024), interpolation=cv2.INTER_CUBIC)
    return np.clip(128 + 35 * picture, 0, 255).astype(np.uint8)


TEXTURES = [texture(seed) for seed in range(len(PLANES))]


def picture(pose: np.ndarray, size: tuple[int, int] = SIZE) -> np.ndarray:
    """What a camera with `MATRIX` sees, RGB."""
    width, height = size
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([(x - 240) / FOCAL, (y - 135) / FOCAL, np.ones_like(x)], -1) @ pose[:3, :3]
    centre = centres_of(pose)
    nearest = np.full(x.shape, np.inf)
    image = np.full((height, width), 200, np.uint8)
    for (origin, along, up, extent), texels in zip(PLANES, TEXTURES, strict=True):
        along, up = np.array(along) / np.linalg.norm(along), np.array(up)
        normal = np.cross(along, up)
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (np.array(origin) - centre) @ normal / (rays @ normal)
            place = centre + depth[..., None] * rays - np.array(origin)
            u, v = place @ along, place @ up
            hit = (depth > 0.1) & (depth < nearest) & (u > 0) & (u < extent[0]) & (v > 0) & (v < extent[1])
        maps = [np.where(hit, value * 64, 0).astype(np.float32) for value in (u, v)]
        seen = cv2.remap(texels, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        image, nearest = np.where(hit, seen, image), np.where(hit, depth, nearest)
    return np.repeat(image[..., None], 3, axis=2)


def walk(count: int, step: float = 0.5) -> np.ndarray:
    """cam_from_world (2, count, 4, 4) of two cameras that look at the square's middle and walk `step` metres."""
    t = np.linspace(0, 1, count)
    poses = []
    for start, direction in (([0.6, 1.5, 4.0], [-1.0, 0.1, 0.3]), ([-1.2, 1.3, 3.8], [0.8, -0.1, 0.6])):
        centres = np.array(start) + step * t[:, None] * np.array(direction)
        centres += 0.02 * step * np.stack([np.sin(9 * t), np.cos(11 * t), np.sin(13 * t + 1)], 1)
        poses.append([look(centre, np.array([0.0, 0.9, 0.0])) for centre in centres])
    return np.array(poses)


def write_video(path: Path, count: int, image: Callable[[int], np.ndarray]) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"crf": "12"})
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        for number in range(count):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image(number)), format="rgb24")
            frame.pts, frame.time_base = number, Fraction(1, 30)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


TOML = """# two phones
name = "square"   # filmed in the yard
up = "y"

[[camera]]
name = "cam0"
video = "cam0.mp4"

[[camera]]
name = "cam1"   # on the left
video = "cam1.mp4"
"""


def film(folder: Path, poses: np.ndarray) -> Path:
    """A capture folder without cameras, keypoints and actor."""
    folder.mkdir(parents=True)
    for camera, path in enumerate(poses):
        write_video(folder / f"cam{camera}.mp4", len(path), lambda number, path=path: picture(path[number]))
    (folder / "capture.toml").write_text(TOML, encoding="utf-8")
    return folder


def film_with_flash(path: Path, poses: np.ndarray, flash: int) -> Path:
    """A video of these poses in which a lamp lights the square for one frame."""

    def image(number: int) -> np.ndarray:
        light = 70 if number == flash else 0
        return np.clip(picture(poses[number]).astype(int) * 0.7 + light, 0, 255).astype(np.uint8)

    return write_video(path, len(poses), image)
