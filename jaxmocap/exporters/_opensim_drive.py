"""Somebody else's OpenSim model, scaled to the tracked person and moved as they moved, by OpenSim itself."""

import importlib.util
import json
import re
import subprocess
import sys
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxmocap._files import write_text
from jaxmocap._results import InputError
from jaxmocap.character import Character, Pose, angles_at_rest
from jaxmocap.motion import Motion

from ._body_mass import body_mass
from ._exporter import ExportForm
from ._marker_set import marker_set
from ._opensim import opensim_name, trc_text

_FEWEST = 8
"""Markers that a model must share with us."""
_ALIASES = {
    **{"hjc": "Hip", "kjc": "Knee", "ajc": "Ankle", "sjc": "Shoulder", "ejc": "Elbow", "wjc": "Wrist"},
    **{"acr": "SHO", "acromium": "SHO", "acromion": "SHO", "lel": "ELB", "mel": "ELM"},
    **{"faradius": "WRA", "faulna": "WRB", "asis": "ASI", "psis": "PSI"},
    **{"lfc": "KNE", "mfc": "KNM", "kneelat": "KNE", "kneemed": "KNM"},
    **{"lmal": "ANK", "mmal": "MED", "anklelat": "ANK", "anklemed": "MED", "cal": "HEE", "calc": "HEE"},
}
"""Names of the models of Rajagopal (2016), of gait2392 and the like, without their side."""
_STUDY = {
    **{"knee": "KNE", "mknee": "KNM", "ankle": "ANK", "mankle": "MED", "toe": "TOE", "shoulder": "SHO"},
    **{"lelbow": "ELB", "melbow": "ELM", "lwrist": "WRA", "mwrist": "WRB"},
}
"""Names of OpenCap's markers, which end in `_study`, where others mean a joint by them."""
_MARKER = re.compile(r"""<Marker\s+name\s*=\s*["']([^"']+)["']""")
_WORKER = Path(__file__).with_name("_opensim_worker.py")


class Driven(NamedTuple):
    """A scaled model and its motion, as OpenSim writes them; how far its markers are off, metres."""

    model: str
    motion: str
    rms: float
    worst: float


def write_driven_osim(motion: Motion, path: Path, form: ExportForm) -> None:
    """Write the named model, scaled to the person, and say how well its markers follow ours."""
    found = _driven(motion, form.opensim_model, form.mass, opensim_name(Path(form.name).stem))
    write_text(path, found.model)
    form.say(
        f"{form.name}: OpenSim's markers are off by {100 * found.rms:.1f} cm (RMS over the motion), "
        f"{100 * found.worst:.1f} cm at most."
    )


def write_driven_mot(motion: Motion, path: Path, form: ExportForm) -> None:
    """Write the coordinates of the named model that OpenSim's inverse kinematics finds."""
    write_text(path, _driven(motion, form.opensim_model, form.mass, opensim_name(Path(form.name).stem)).motion)


@lru_cache(maxsize=1)
def _driven(motion: Motion, files: tuple[Path, ...], mass: float | None, name: str) -> Driven:
    """Let OpenSim scale the model and solve for our markers, in a process of its own.

    `files` are the model and, where that is a file of its own, its marker set.
    """
    if importlib.util.find_spec("opensim") is None:
        raise InputError(
            "another model is driven by OpenSim, which is not installed; run pip install 'jaxmocap[opensim]'."
        )
    names = shared_markers(files, motion.character)
    markers = marker_set(motion.character)
    order = [markers.names.index(ours) for ours in names.values()]
    standing = np.repeat(markers.along(_standing(motion.character)), 2, axis=0)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        for file, times, places in (
            ("standing", np.array([0.0, 1.0]), standing),
            ("moving", motion.timestamps, markers.along(motion)),
        ):
            text = trc_text(f"{file}.trc", tuple(names), times, 1000 * places[:, order], "mm", 30.0)
            write_text(place / f"{file}.trc", text)
        model, *sets = (str(file.resolve()) for file in files)
        job: dict[str, Any] = {"model": model, "markers": sets[0] if sets else "", "names": names, "name": name}
        job["mass"] = float(body_mass(motion.character, mass).masses.sum())
        job["standing"] = dict(zip(markers.names, standing[0].tolist(), strict=True))
        write_text(place / "job.json", json.dumps(job))
        command = [sys.executable, "-I", str(_WORKER), str(place / "job.json")]
        done = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
        if not (place / "done.json").is_file():
            said = [line.strip() for line in (done.stderr or done.stdout).splitlines() if line.strip()]
            raise InputError(f"OpenSim could not use {model} ({said[-1] if said else 'no reason given'}).")
        told = json.loads((place / "done.json").read_text())
        rms, worst = np.array(told["rms"]), np.array(told["worst"])
        model, solved = ((place / file).read_text() for file in ("scaled.osim", "solved.mot"))
    return Driven(model, solved, float(np.sqrt(np.mean(rms**2))), float(worst.max()))


def shared_markers(files: tuple[Path, ...], character: Character) -> dict[str, str]:
    """Match a model's markers with ours: {its name: our name}. Raises `InputError` where too few are known."""
    texts = []
    for file in files:
        try:
            texts.append(file.read_text(encoding="utf-8", errors="replace"))
        except OSError as error:
            raise InputError(f"the OpenSim file {file} cannot be read ({error.strerror or error}).") from error
        if "<OpenSimDocument" not in texts[-1]:
            raise InputError(
                f"{file} is no file of OpenSim's; a model (.osim), and its marker set (.xml), were expected."
            )
    found = _MARKER.findall(texts[-1])
    known = {name.lower(): name for name in marker_set(character).names}
    names: dict[str, str] = {}
    for name in found:
        ours = _ours(name, known)
        if ours and ours not in names.values():
            names[name] = ours
    if len(names) < _FEWEST:
        raise InputError(
            f"{files[-1]} has {len(names)} markers that we know ({', '.join(names) or 'none'}); at least {_FEWEST} of "
            "the usual names (RASI, RKNE, RHip, RKnee and the like) are needed; name its marker set's file after it."
        )
    return names


def _ours(name: str, known: dict[str, str]) -> str | None:
    """Find our marker for a name of another model's."""
    study = name.lower().endswith("_study")
    plain = re.sub(r"[._ ]", "", name.lower().removesuffix("_study"))
    side, rest = plain[:1].upper(), plain[1:]
    if study and side in "LR" and rest in _STUDY:
        return known.get((side + _STUDY[rest]).lower())
    if plain in known:
        return known[plain]
    if plain in ("chip", "midhip", "hip"):
        return known.get("midhip")
    return known.get((side + _ALIASES[rest]).lower()) if side in "LR" and rest in _ALIASES else None


def _standing(character: Character) -> Motion:
    """Stand the character upright with hanging arms, as most models do by default."""
    skeleton = character.skeleton
    angles = -angles_at_rest(skeleton)
    for side in "lr":
        if f"{side}_shoulder_abd" in skeleton.angle_names:
            angles[skeleton.angle_names.index(f"{side}_shoulder_abd")] -= np.radians(85)
    pose = Pose(np.eye(4, dtype=np.float32)[None], angles[None].astype(np.float32))  # pyright: ignore[reportArgumentType]
    return Motion.from_poses(character, pose, [0], [0.0])
