"""Files that bring a skin of their own: joints are recognised and weights kept."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.character import Character, capsules, has_skin, simplify

from ._turned_out import turned_out


def brings_skin(path: Path) -> bool:
    """Whether a file is a body model, or a glTF file whose mesh is bound to joints."""
    suffix = path.suffix.lower()
    return suffix == ".npz" or (suffix in (".glb", ".gltf", ".vrm") and has_skin(path))


def keep_skin(
    path: Path, num_faces: int, mapping: str | Path | Mapping[str, str] | None
) -> tuple[Character, dict[str, Any]]:
    """The character in the file with at most about `num_faces` triangles, and the report on it."""
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


def radii_cm(character: Character) -> dict[str, float]:
    """The radius of each bone's capsule, centimetres."""
    radii = 100 * capsules(character).radii
    return {body: round(float(radius), 2) for body, radius in zip(character.skeleton.body_names, radii, strict=True)}
