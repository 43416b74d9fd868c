"""A synthetic capture as a folder on disk, laid out like any other capture."""

import json
from fractions import Fraction
from pathlib import Path

import av
import cv2
import jax
import numpy as np

from jaxmocap._files import atomic_folder
from jaxmocap.camera import write_colmap_text
from jaxmocap.character import pose_vector

from ._capture import SyntheticCapture

_CRF = 14


def write_capture(capture: SyntheticCapture, folder: str | Path) -> Path:
    """Write a synthetic capture to a folder, whole or not at all; return the folder.

    It holds `capture.toml`, H.264 videos, the camera model, the actor, keypoints and masks at the selected frames, and
    `truth.npz`. Raises `FileExistsError` if `folder` exists and is not empty.
    """
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise FileExistsError(f"{folder} exists already; choose a new folder for the synthetic capture.")
    with atomic_folder(folder) as partial:
        _write_into(capture, partial)
    return folder


def _write_into(capture: SyntheticCapture, folder: Path) -> None:
    names = capture.cameras.names
    (folder / "capture.toml").write_text(_toml(capture), encoding="utf-8")
    for camera, name in enumerate(names):
        _write_video(folder / f"{name}.mp4", capture.images[:, camera], capture.fps)
    write_colmap_text(capture.cameras, folder / "cameras")
    capture.character.save_glb(folder / "actor.glb")
    for part in ("keypoints", "masks"):
        (folder / part).mkdir()
    for row, frame in enumerate(capture.selected_frames):
        for camera, name in enumerate(names):
            person = {"person_id": [-1], "pose_keypoints_2d": capture.keypoints[row, camera].round(3).ravel().tolist()}
            path = folder / "keypoints" / f"{name}_{frame:05d}_keypoints.json"
            path.write_text(json.dumps({"version": 1.3, "people": [person]}), encoding="utf-8")
            mask = np.where(capture.masks[frame, camera], 255, 0).astype(np.uint8)
            cv2.imwrite(str(folder / "masks" / f"{name}_{frame:05d}.png"), mask)
    skeleton = capture.character.skeleton
    np.savez(
        folder / "truth.npz",
        markers=capture.markers,
        joints=capture.joints,
        joint_names=np.array(capture.joint_names),
        joint_definitions=np.array("jaxmocap"),  # the actor's own joints: all of them may be compared
        fps=np.array(capture.fps),
        timestamps=capture.timestamps,
        root=np.asarray(capture.poses.root),
        angles=np.asarray(capture.poses.angles),
        pose=np.asarray(jax.jit(jax.vmap(pose_vector, (None, 0)))(skeleton, capture.poses)),
        dof_names=np.array(skeleton.dof_names),
    )


def _toml(capture: SyntheticCapture) -> str:
    cameras = "".join(f'\n[[camera]]\nname = "{name}"\nvideo = "{name}.mp4"\n' for name in capture.cameras.names)
    return f"""name = "{capture.name}"
fps = {capture.fps:g}
frames = {capture.num_frames}
units = "metres"
up = "y"
actor = "actor.glb"
cameras = "cameras"
selected_frames = {list(capture.selected_frames)}
keypoints = "keypoints"
masks = "masks"
truth = "truth.npz"            # for evaluation only
{cameras}"""


def _write_video(path: Path, images: np.ndarray, fps: float) -> None:
    """Write H.264 of high quality; frame i is shown at i / fps.

    The same images give the same bytes: x264's macroblock tree, which reads memory that nobody has set, is off.
    """
    rate = Fraction(fps).limit_denominator(1001)
    options = {"crf": str(_CRF), "preset": "medium", "x264-params": "mbtree=0"}
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=rate, options=options)
        stream.width, stream.height, stream.pix_fmt = images.shape[2], images.shape[1], "yuv420p"
        stream.codec_context.time_base = 1 / rate
        stream.codec_context.thread_count = 1
        for number, image in enumerate(images):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
            frame.pts, frame.time_base = number, 1 / rate
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
