"""COLMAP: the cameras, one image per view and frame."""

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from jaxmocap._results import InputError
from jaxmocap.camera import write_colmap_text
from jaxmocap.motion import Motion

from ._exporter import ExportForm


def write_colmap(motion: Motion, path: Path, form: ExportForm) -> None:
    """Write the cameras as a COLMAP text model without points.

    Images of all cameras are called `<camera>/<frame>.png` by the frames of the motion, which are those of the first
    camera's video, with `_` for blanks. A comment says which unit and vertical axis. Raises `InputError` where the
    motion has no cameras, and where two would have one name.
    """
    if motion.cameras is None:
        raise InputError(f"{form.name} holds cameras, but the motion comes without any; track it again.")
    poses = np.array(motion.cameras.cam_from_world, np.float64)
    poses[..., :3, 3] *= form.per_metre
    names = tuple("_".join(name.split()) for name in motion.cameras.names)  # COLMAP ends an image's name at a blank
    if len(set(names)) < len(names):
        raise InputError(f"{form.name} would have two cameras of one name, with _ for blanks: {', '.join(names)}.")
    cameras = replace(motion.cameras, names=names, cam_from_world=jnp.asarray(poses))
    recorded = motion.provenance.get("recorded_sizes")
    if recorded:  # pixels of the videos, of which the pictures that were tracked may be smaller copies
        cameras = cameras.resized(tuple((int(width), int(height)) for width, height in recorded))
    write_colmap_text(cameras, path, frames=np.tile(motion.frames, (cameras.num_cameras, 1)))
    images = path / "images.txt"
    rate = "varying" if form.frame_rate is None else f"{form.frame_rate:.9g}"
    note = f"# units: {form.units}, up: {form.up}, frames per second: {rate}\n"
    images.write_text(note + images.read_text(encoding="utf-8"), encoding="utf-8")
