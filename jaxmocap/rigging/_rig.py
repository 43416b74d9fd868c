"""`rig`: from a bare mesh of a standing person to a character that tracks (Sec. 3.1; Baran and Popovic 2007)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxmocap._results import InputError
from jaxmocap.character import REQUIRED, Character, capsules, has_skin, simplify

from ._bind import bind, turned_out
from ._embed import Embedding, embed, in_rest_frame
from ._fit_template import exact, samples
from ._keypoints import read_hints, report_on
from ._read_mesh import ADULT, Mesh, axis_name, metres_per_unit, named_axis, read_mesh
from ._repair import Repair, repaired

_FAR, _COVERED = 0.045, 0.5
_SURE = 0.05
_FEWEST, _MOST = 300, 200_000


@dataclass(frozen=True)
class RiggedMesh:
    """A character made of a mesh, and how.

    Attributes:
        character: the result.
        report: what was found and done, as JSON knows it. `skin`: whether the file brought one; `repairs`; `units` of
            the file; `height_m` of the person; which of the file's axes are `up` and `front`; `distance_cm` of the mesh
            from the body laid into it; `turned_out`, the share of the triangles that turns inside out at the worst
            limit of a joint; `radii_cm` of the body around each bone; `front_margin`, the share by which it fits worse
            when it faces the other way; how far the joints are from where `keypoints` have them; `warnings`.
        rest_from_file: takes the file's units and axes to the character's metres and rest frame; None where the file
            brought a skin of its own, which is kept.
    """

    character: Character
    report: dict[str, Any]
    rest_from_file: Float[np.ndarray, "4 4"] | None = None


def rig(
    mesh: str | Path | Mesh,
    *,
    num_faces: int = 5000,
    height: float | None = None,
    units: str | None = None,
    up: str | None = None,
    front: str | None = None,
    joints: Mapping[str, Any] | None = None,
    keypoints: str | Path | None = None,
    mapping: str | Path | Mapping[str, str] | None = None,
    anew: bool = False,
    name: str | None = None,
) -> RiggedMesh:
    """Make a character of 39 degrees of freedom of the mesh of a person who stands.

    `mesh` is a file (OBJ, PLY, STL, OFF, GLB) or its vertices and faces. It is repaired and simplified to about
    `num_faces` triangles, and gets joints and skinning weights. T-, A- and relaxed poses, any orientation, units and
    mirrored files will do. Help, where it goes wrong: `height` in metres; `units` (m, cm, mm, in, ft, dm); `up` and
    `front`, axes of the file such as "z" or "-y"; `joints`, places in the file's units and axes of any of `pelvis`,
    `neck` and, per side, `l_`/`r_` `shoulder elbow wrist hip knee ankle`; `keypoints`, a folder of pictures that
    `rig_pictures` drew of the same mesh, with what a detector found in them (files as a capture's may be, such as
    `front_keypoints.json`), or one such file. Keypoints tell up and front too, and draw joints near without fixing
    them: a detector is some centimetres off.

    The skin of a skinned glTF file or body model is kept, its joints recognised or named by `mapping` as in
    `Character.load`, unless `anew`. Raises `InputError` where no standing person is found.
    """
    refuse_number_of_triangles(num_faces)
    if isinstance(mesh, str | Path) and not anew and brings_skin(Path(mesh)):
        if any(option is not None for option in (height, units, up, front, joints, keypoints)):
            raise InputError(f"{mesh} has a skin of its own, which is kept; help is for rigging it anew (--anew).")
        return RiggedMesh(*keep_skin(Path(mesh), num_faces, mapping))
    if mapping is not None:
        raise InputError("a mapping names the joints of a skinned file; this mesh has none, or is rigged anew.")
    label = str(mesh) if isinstance(mesh, str | Path) else name or "the mesh"
    wanted_up, wanted_front = (named_axis(option, axis) for option, axis in (("up", up), ("front", front)))
    vertices, faces = read_mesh(Path(mesh)) if isinstance(mesh, str | Path) else mesh
    before = len(faces)
    clean = repaired(label, vertices, faces, num_faces)
    given = _pins(joints)
    hints = None if keypoints is None else read_hints(keypoints, clean.vertices, clean.faces)
    pins = ({} if hints is None else hints.pins) | {joint: exact(place) for joint, place in given.items()}
    if hints is not None:
        wanted_up = hints.up if wanted_up is None else wanted_up
        wanted_front = hints.front if wanted_front is None else wanted_front
    found = embed(samples(clean.vertices, clean.faces), wanted_up, wanted_front, pins)
    found = _person(found, label)
    turned = in_rest_frame(clean.vertices, found, given)
    metre, unit = metres_per_unit(label, float(np.ptp(turned.vertices[:, 1])), height, units)
    placed = turned.scaled(metre)
    title = name or (Path(mesh).stem if isinstance(mesh, str | Path) else "rigged mesh")
    character = bind(title, placed.vertices, clean.faces, placed.places, placed.laid)
    tall = float(np.ptp(placed.vertices[:, 1]))
    report = {
        "triangles": {"before": before, "after": len(clean.faces)},
        "skin": "made",
        "closed": _closed(clean.faces),
        "repairs": clean.done,
        "units": unit,
        "height_m": round(tall, 4),
        "up": axis_name(placed.rest_from_file[1, :3]),
        "front": axis_name(placed.rest_from_file[2, :3]),
        "distance_cm": round(100 * found.distance, 2),
        "turned_out": round(turned_out(character), 4),
        "radii_cm": radii_cm(character),
        "front_margin": round(found.front_margin, 3) if np.isfinite(found.front_margin) else None,
        "keypoints": None if hints is None else report_on(hints, placed.places, placed.rest_from_file),
        "warnings": _warnings(found, clean, tall, sized=bool(height or units)),
    }
    return RiggedMesh(character, report, placed.rest_from_file)


def _person(found: Embedding | None, label: str) -> Embedding:
    """Refuse what is no standing person."""
    hint = (
        "a whole person who stands upright, hands and feet free, is needed: remove a floor and other things from a "
        "scan, or say with --up and --front which way it stands"
    )
    if found is None:
        raise InputError(f"{label} has the proportions of no standing person in any orientation; {hint}.")
    if found.distance > _FAR:
        raise InputError(
            f"{label} does not look like a standing person: the body that fits best is {100 * found.distance:.0f} cm "
            f"off in the median; {hint}."
        )
    sides = {"l": "left", "r": "right"}
    missing = [" ".join(sides.get(word, word) for word in body.split("_")) for body in found.uncovered(_COVERED)]
    if missing:
        raise InputError(f"{label} shows no {' and no '.join(missing)} where a standing person has it; {hint}.")
    return found


def _warnings(found: Embedding, clean: Repair, tall: float, sized: bool) -> list[str]:
    said = []
    if not sized and not ADULT[0] <= tall <= ADULT[1]:
        said.append(f"the person is {tall:.2f} m tall if the file is in metres; give the height if that is wrong")
    if found.front_margin < _SURE:
        said.append("front and back fit nearly equally well; look at the result, and give the front if it is wrong")
    if len(clean.faces) < 2000:
        said.append(f"the mesh has {len(clean.faces):,} triangles; about 5,000 track better")
    return said


def _closed(faces: np.ndarray) -> bool:
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    return bool(np.all(count % 2 == 0))


def _pins(joints: Mapping[str, Any] | None) -> dict[str, np.ndarray]:
    pins = {}
    for joint, place in (joints or {}).items():
        if joint not in REQUIRED:
            raise InputError(f"{joint!r} is no joint that can be given; use any of {', '.join(REQUIRED)}.")
        try:
            pins[joint] = np.asarray(place, np.float64).reshape(3)
        except (TypeError, ValueError):
            raise InputError(f"joint {joint} is at {place!r}; three numbers were expected.") from None
        if not np.all(np.isfinite(pins[joint])):
            raise InputError(f"joint {joint} is at {place!r}; three finite numbers were expected.")
    return pins


def brings_skin(path: Path) -> bool:
    """Tell whether a file is a body model, or a glTF file whose mesh is bound to joints."""
    suffix = path.suffix.lower()
    return suffix == ".npz" or (suffix in (".glb", ".gltf", ".vrm") and has_skin(path))


def keep_skin(
    path: Path, num_faces: int, mapping: str | Path | Mapping[str, str] | None
) -> tuple[Character, dict[str, Any]]:
    """Load the character in the file with at most about `num_faces` triangles, and report on it."""
    loaded = Character.load(path, mapping)
    character, _ = simplify(loaded, num_faces)
    before, after = len(loaded.faces), len(character.faces)
    report = {
        "triangles": {"before": before, "after": after},
        "skin": "kept",
        "repairs": [f"simplified {before:,} triangles to {after:,}"] if after < before else [],
        "height_m": round(float(np.ptp(np.asarray(character.vertices)[:, 1])), 4),
        "turned_out": round(turned_out(character), 4),
        "radii_cm": radii_cm(character),
        "warnings": [],
    }
    return character, report


def refuse_number_of_triangles(count: int) -> None:
    """Raise `InputError` for a number of triangles that no character should have."""
    if not _FEWEST <= count <= _MOST:
        raise InputError(f"{count} triangles were asked for; choose {_FEWEST} to {_MOST:,}.")


def radii_cm(character: Character) -> dict[str, float]:
    """Measure the radius of each bone's capsule, centimetres."""
    radii = 100 * capsules(character).radii
    return {body: round(float(radius), 2) for body, radius in zip(character.skeleton.body_names, radii, strict=True)}


def refuse_unreadable_actor(path: Path) -> None:
    """Raise `InputError` for a file that holds neither a character nor a mesh, which may still be nobody's."""
    if brings_skin(path):
        Character.load(path)
    else:
        read_mesh(path)


def open_actor(path: str | Path, say: Callable[[str], None] | None = None, height: float | None = None) -> Character:
    """Open the character in a skinned glTF file or body model, or rig a bare mesh on the spot and tell `say` about it.

    A bare mesh becomes `height` metres tall, where that is known. Raises `InputError` as `Character.load` and `rig` do.
    """
    path = Path(path)
    if brings_skin(path):
        return Character.load(path)
    try:
        rigged = rig(path, height=height)
    except InputError as error:
        raise InputError(
            f"{error} Options that are named here are those of jaxmocap rig {path} --out ACTOR.glb: rig it first, and "
            "give what that wrote."
        ) from error
    if say is not None:
        report = rigged.report
        say(
            f"{path} has no skeleton and was rigged: {report['triangles']['after']:,} triangles, "
            f"{report['height_m']:.2f} m tall. `jaxmocap rig` keeps the result and draws it."
        )
        for warning in report["warnings"]:
            say(f"{path}: {warning}.")
    return rigged.character
