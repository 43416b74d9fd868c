"""FBX and .blend, written by Blender in a process of its own: the skinned actor, its rig, the clip, moving cameras."""

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap._files import write_bytes
from jaxmocap._results import InputError
from jaxmocap.motion import Motion, turned

from ._exporter import ExportForm
from ._glb import write_glb
from ._prepare import mean_rate_of

WHERE = "JAXMOCAP_BLENDER"
"""An environment variable that names Blender, or a Python that has its module `bpy`."""
_WORKER = Path(__file__).with_name("_blender_worker.py")


def write_blender(motion: Motion, path: Path, form: ExportForm) -> None:
    """Let Blender make an FBX or a .blend file of the GLB of a motion; its first frame is frame 0.

    Unlike in a GLB, cameras keep the principal point of their videos. Raises `InputError` where there is no Blender,
    and where it does not do it.
    """
    command = blender_command()
    rate = form.frame_rate or mean_rate_of(motion)
    counted = replace(turned(motion, "y"), timestamps=np.arange(len(motion)) / rate)  # as glTF has it
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        out = place / f"out{Path(form.name).suffix.lower()}"
        job: dict[str, Any] = {"scene": str(place / "scene.glb"), "out": str(out), "rate": rate, "frames": len(motion)}
        job["cameras"] = {}
        if (cameras := counted.cameras) is not None:
            for index, (name, size) in enumerate(zip(cameras.names, cameras.sizes, strict=True)):
                lens = np.asarray(cameras.intrinsics[index], float).tolist()
                job["cameras"][f"jaxmocap_camera_{index}"] = {"name": name, "size": list(size), "intrinsics": lens}
            counted = replace(counted, cameras=replace(cameras, names=tuple(job["cameras"])))  # none of the actor's
        write_glb(counted, place / "scene.glb", form)
        (place / "job.json").write_text(json.dumps(job), encoding="utf-8")
        own = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        done = subprocess.run(
            [*command, str(place / "job.json")], cwd=place, env=own, capture_output=True, text=True, check=False
        )
        if done.returncode or not out.is_file():
            said = [line.strip() for line in (done.stderr or done.stdout).splitlines() if line.strip()]
            raise InputError(f"Blender could not write {form.name} ({said[-1] if said else 'no reason given'}).")
        write_bytes(path, out.read_bytes())


def blender_command() -> list[str]:
    """Find Blender: what `JAXMOCAP_BLENDER` names, the module in this Python, or the program on the path.

    Returns the command that runs the worker, without its job. Raises `InputError` where there is none.
    """
    named = os.environ.get(WHERE)
    if named and shutil.which(named) is None:
        raise InputError(f"{WHERE} names {named}, which is no program; name Blender, or a Python that has bpy.")
    if not named and importlib.util.find_spec("bpy") is not None:
        named = sys.executable
    found = shutil.which(named or "blender")
    if not found:
        raise InputError(
            "FBX and .blend are written by Blender, which was not found; install it, or let JAXMOCAP_BLENDER name it "
            "or a Python of its own that has bpy."
        )
    named = str(Path(found).absolute())  # it runs in another folder; a link is kept, which a venv's Python is
    if Path(named).name.lower().startswith("python"):
        return [named, "-I", str(_WORKER)]
    options = ["-b", "--factory-startup", "-noaudio", "--python-exit-code", "3", "-P"]
    return [named, *options, str(_WORKER), "--"]
