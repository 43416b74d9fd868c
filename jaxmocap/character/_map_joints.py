"""From a file's joints to our 18 bodies: which joint is which, where our joints are, and whose weights are whose."""

import json
import tomllib
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, NoReturn, Protocol

import numpy as np

from jaxmocap._results import InputError

from ._dof_table import BODIES, LANDMARKS
from ._joint_names import ancestors, common_ancestor, roles_by_name
from ._joint_places import roles_by_place
from ._read_skin import RawSkin

BODY_NAMES = tuple(body for body, _, _ in BODIES)
LIMBS = tuple(
    tuple(f"{side}_{body}" for body in chain)
    for side in "lr"
    for chain in (("upper_arm", "forearm", "hand"), ("thigh", "shank", "foot"))
)
_NEEDED = ("chest", "head", *(body for limb in LIMBS for body in limb))
_JOINT_OF_BODY = {body: joint for body, _, joint in BODIES}
_THORAX = 0.4  # T8 as a fraction of the way from L4 to C7


class Source(Protocol):
    """The file that joints come from; `fail` raises an `InputError` that names it."""

    @property
    def path(self) -> Path: ...

    def fail(self, message: str) -> NoReturn: ...


class MappedJoints(NamedTuple):
    """Our joints and known landmarks in the file's frame, the weights (V, 18) by body, the number of the body that
    each of the file's joints belongs to, and the joint at which each body begins, where there is one."""

    places: dict[str, np.ndarray]
    body_weights: np.ndarray
    bodies: tuple[int, ...]
    anchors: dict[str, int]


def map_joints(document: Source, raw: RawSkin, mapping: str | Path | Mapping[str, str] | None) -> MappedJoints:
    """Find our bodies among the file's joints: by the caller's mapping, then by name, then by place.

    Raises `InputError` naming the bodies that could not be found, or a mapping that does not fit the file.
    """
    saved = _saved_landmarks(raw)
    if saved is not None and mapping is None:
        own = {body: raw.joint_names.index(body) for body in BODY_NAMES}
        return MappedJoints(saved, raw.weights[:, list(own.values())], _followed(raw, own, {}), own)
    given = _read_mapping(document, raw, mapping)
    roles = roles_by_name(raw.joint_names, raw.joint_parents)
    anchors = {**_anchors(roles, raw), **_topmost(given, raw)}
    missing = _missing(anchors, raw.joint_parents)
    if missing:
        roles = roles_by_place(raw)
        anchors = {**_anchors(roles, raw), **_topmost(given, raw)}
        if _missing(anchors, raw.joint_parents):
            names = ", ".join(raw.joint_names[:40])
            document.fail(
                f"is not recognised as a person: no joint was found for {', '.join(missing)}; give a mapping file with "
                f'lines like `"{raw.joint_names[0]}" = "pelvis"` (file joint = body) for its joints {names}'
            )
    if "pelvis" not in anchors:
        shared = common_ancestor(anchors["l_thigh"], anchors["r_thigh"], raw.joint_parents)
        anchors["pelvis"] = anchors["l_thigh"] if shared is None else shared
    bodies = _followed(raw, anchors, given)
    weights = np.zeros((len(raw.weights), len(BODY_NAMES)))
    for joint, body in enumerate(bodies):
        weights[:, body] += raw.weights[:, joint]
    places = {_JOINT_OF_BODY[body]: raw.joint_places[joint] for body, joint in anchors.items()}
    if "abdomen" not in anchors:
        _split_trunk(places, weights, raw.vertices)
    if roles.get("head", anchors["head"]) != anchors["head"]:
        places["head"] = raw.joint_places[roles["head"]]
    return MappedJoints(places, weights, bodies, anchors)


def _followed(raw: RawSkin, anchors: Mapping[str, int], given: Mapping[int, str]) -> tuple[int, ...]:
    """For every joint the body that its nearest ancestor with one begins, or that is given; else the pelvis."""
    owner = {joint: body for body, joint in anchors.items()} | dict(given)
    lines = [[joint, *ancestors(joint, raw.joint_parents)] for joint in range(len(raw.joint_names))]
    return tuple(BODY_NAMES.index(next((owner[j] for j in line if j in owner), "pelvis")) for line in lines)


def _anchors(roles: Mapping[str, int], raw: RawSkin) -> dict[str, int]:
    """Choose the joint at which each body begins."""
    anchors = {role: joint for role, joint in roles.items() if role in BODY_NAMES}
    if "neck" in roles:
        anchors["head"] = roles["neck"]
    spine = [roles[f"spine{number}"] for number in range(len(roles)) if f"spine{number}" in roles]
    if len(spine) == 1:
        anchors["chest"] = spine[0]
    elif spine and "head" in anchors:
        low, top = raw.joint_places[spine[0]], raw.joint_places[anchors["head"]]
        axis = (top - low) / max(np.sum((top - low) ** 2), 1e-12)
        anchors["abdomen"] = spine[0]
        anchors["chest"] = min(spine[1:], key=lambda joint: abs((raw.joint_places[joint] - low) @ axis - _THORAX))
    return anchors


def _missing(anchors: Mapping[str, int], parents: Sequence[int]) -> list[str]:
    """Bodies without a joint, and limbs whose joints do not follow one another."""
    missing = [body for body in _NEEDED if body not in anchors]
    for limb in LIMBS:
        for upper, lower in pairwise(limb):
            if upper in anchors and lower in anchors and anchors[upper] not in ancestors(anchors[lower], parents):
                missing.append(lower)
    return missing


def _split_trunk(places: dict[str, np.ndarray], weights: np.ndarray, vertices: np.ndarray) -> None:
    """Place the missing one of lumbar and thorax in a trunk with one joint; weights change over across it."""
    low = 0.5 * (places["l_hip"] + places["r_hip"])
    axis = places["neck"] - low
    length = np.linalg.norm(axis)
    axis = axis / length
    height = lambda place: (place - low) @ axis / length  # noqa: E731
    if height(places["thorax"]) < 0.4:
        places["spine"] = places["thorax"]
        places["thorax"] = places["spine"] + _THORAX * (places["neck"] - places["spine"])
        lower, upper, joint = "abdomen", "chest", places["thorax"]
        weights[:, BODY_NAMES.index("abdomen")] = weights[:, BODY_NAMES.index("chest")]
        weights[:, BODY_NAMES.index("chest")] = 0.0
    else:
        places["spine"] = low + 0.18 * (places["neck"] - low)
        lower, upper, joint = "pelvis", "abdomen", places["spine"]
    share = np.clip((height(vertices) - height(joint)) / 0.2 + 0.5, 0.0, 1.0)
    moved = share * weights[:, BODY_NAMES.index(lower)]
    weights[:, BODY_NAMES.index(upper)] += moved
    weights[:, BODY_NAMES.index(lower)] -= moved


def _topmost(given: Mapping[int, str], raw: RawSkin) -> dict[str, int]:
    """For every body of a mapping, the joint nearest the root."""
    anchors: dict[str, int] = {}
    for joint, body in given.items():
        depth = len(ancestors(joint, raw.joint_parents))
        if body not in anchors or depth < len(ancestors(anchors[body], raw.joint_parents)):
            anchors[body] = joint
    return anchors


def _read_mapping(document: Source, raw: RawSkin, mapping: str | Path | Mapping[str, str] | None) -> dict[int, str]:
    """Read a mapping as {file joint: body}."""
    if mapping is None:
        return {}
    where = "the mapping" if isinstance(mapping, Mapping) else str(mapping)
    content = mapping if isinstance(mapping, Mapping) else _read_table(Path(mapping))
    given = {}
    for name, body in content.items():
        if body not in BODY_NAMES:
            raise InputError(f"{where}: {body!r} is not one of our bodies; use one of {', '.join(BODY_NAMES)}.")
        if name not in raw.joint_names:
            names = ", ".join(raw.joint_names[:40])
            raise InputError(f"{where}: {document.path} has no joint named {name!r}; its joints are {names}.")
        given[raw.joint_names.index(name)] = body
    return given


def _read_table(path: Path) -> Mapping[str, str]:
    if not path.is_file():
        raise InputError(f"{path} does not exist; a mapping is a JSON or TOML file of file joint = body.")
    text = path.read_text(encoding="utf-8", errors="replace")
    try:
        content = json.loads(text) if path.suffix.lower() == ".json" else tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not readable as JSON or TOML: {error}.") from None
    if not isinstance(content, dict) or not all(isinstance(body, str) for body in content.values()):
        raise InputError(f"{path} must be one flat table of file joint = body, both as text.")
    return content


def _saved_landmarks(raw: RawSkin) -> dict[str, np.ndarray] | None:
    """Read the landmarks `save_glb` left in the file, if the joints still stand where it put them."""
    saved = raw.extras.get("jaxmocap_landmarks") if isinstance(raw.extras, dict) else None
    if not isinstance(saved, dict) or set(saved) != {name for name, _ in LANDMARKS}:
        return None
    if not set(BODY_NAMES) <= set(raw.joint_names):
        return None
    try:
        places = {name: np.array(place, dtype=np.float64).reshape(3) for name, place in saved.items()}
    except (TypeError, ValueError):
        return None
    stand = [raw.joint_places[raw.joint_names.index(body)] - places[joint] for body, _, joint in BODIES]
    return places if np.all(np.abs(stand) < 1e-4) else None


def saved_misfit(raw: RawSkin) -> float:
    """Read the misfit `save_glb` left in the file, metres; 0 where there is none."""
    saved = raw.extras.get("jaxmocap_misfit") if isinstance(raw.extras, dict) else None
    return float(saved) if isinstance(saved, int | float) and 0 <= saved < 1 else 0.0
