"""Make the picture of the README from the result of the demo: `jaxmocap demo --out demo --frames 12`, then
`python docs/make_pictures.py demo`. Nothing but the synthetic dancer is ever shown."""

import sys
from pathlib import Path

import cv2
import numpy as np

import jaxmocap as jm
from jaxmocap._files import write_bytes
from jaxmocap.viewers import contact_sheet, overlay_frames

PICTURES = Path(__file__).parent / "pictures"
COLUMNS, SIDE = 4, 260


def main(demo: Path) -> None:
    capture = jm.Capture.open(demo / "capture")
    motion = jm.Motion.load(demo / "result")
    picked = motion[np.linspace(0, len(motion) - 1, COLUMNS).astype(int)]
    rows = []
    for camera in range(capture.num_cameras):
        frames = overlay_frames(capture, capture.cameras, motion.character, picked, camera)
        rows += [_around(image, _box(picked, camera)) for _, image in frames]
    sheet = contact_sheet(rows, COLUMNS)
    PICTURES.mkdir(exist_ok=True)
    coded = cv2.imencode(".jpg", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 85])[1]
    write_bytes(PICTURES / "demo.jpg", coded.tobytes())


def _box(picked: jm.Motion, camera: int) -> np.ndarray:
    """Left, top, right, bottom of a square around the person in the picked frames of a view."""
    cameras = picked.cameras
    assert cameras is not None
    pixels = []
    for index in range(len(picked)):
        k, cam_from_world = np.asarray(cameras.intrinsics[camera]), np.asarray(cameras.cam_from_world[camera, index])
        seen = (picked.vertices(index) @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]) @ k.T
        pixels.append(seen[:, :2] / seen[:, 2:])
    together = np.concatenate(pixels)
    middle, half = (together.min(0) + together.max(0)) / 2, (np.ptp(together, axis=0) / 2 + 12).max()
    return np.concatenate([middle - half, middle + half]).astype(int)


def _around(image: np.ndarray, box: np.ndarray) -> np.ndarray:
    left, top, right, bottom = box
    room = max(-left, -top, right - image.shape[1], bottom - image.shape[0], 0)
    wide = np.pad(image, ((room, room), (room, room), (0, 0)), mode="edge")
    return cv2.resize(wide[top + room : bottom + room, left + room : right + room], (SIDE, SIDE))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
