"""Which joint of a file is which, by place: where names say nothing, the tree and its lengths still show a person."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from jaxmocap.geometry import unit

from ._joint_names import ancestors
from ._read_skin import RawSkin

_SIMILAR = 0.2  # relative difference of length allowed between a left and a right limb
_SHORTEST_LIMB = 0.2  # of the skeleton's longest path; fingers and face bones are shorter


class _Tree(NamedTuple):
    places: np.ndarray
    parents: tuple[int, ...]
    children: tuple[tuple[int, ...], ...]
    reach: np.ndarray  # length of the longest path below each joint

    def length(self, child: int) -> float:
        """Measure the longest path from the child's parent through the child."""
        parent = self.parents[child]
        return float(np.linalg.norm(self.places[child] - self.places[parent]) + self.reach[child])

    def longest_path(self, joint: int) -> list[int]:
        """Follow the longest path from a joint through its descendants, the joint included."""
        path = [joint]
        while self.children[path[-1]]:
            path.append(max(self.children[path[-1]], key=self.length))
        return path


def roles_by_place(raw: RawSkin) -> dict[str, int]:
    """Read the roles of `roles_by_name` off the hierarchy; none where it does not look like a person.

    The hips are the joint nearest the root with two equally long limbs; the chest is the one below it. Feet give
    forward, hence left and right.
    """
    tree = _tree(raw)
    pairs = {joint: pair for joint in range(len(raw.joint_names)) if (pair := _pair(tree, joint)) is not None}
    for hips in sorted(pairs, key=lambda joint: len(ancestors(joint, tree.parents))):
        legs = pairs[hips]
        inside_legs = {joint for leg in legs for joint in _below(tree, leg)}
        chests = [j for j in pairs if hips in ancestors(j, tree.parents) and j not in inside_legs]
        for chest in sorted(chests, key=lambda joint: len(ancestors(joint, tree.parents))):
            roles = _assemble(raw, tree, hips, legs, chest, pairs[chest])
            if roles:
                return roles
    return {}


def _assemble(
    raw: RawSkin, tree: _Tree, hips: int, legs: tuple[int, int], chest: int, arms: tuple[int, int]
) -> dict[str, int]:
    others = [child for child in tree.children[chest] if child not in arms]
    leg_triples = [_triple(tree, tree.longest_path(leg)) for leg in legs]
    arm_triples = [_triple(tree, _to_the_hand(tree, tree.longest_path(arm))) for arm in arms]
    if not others or None in leg_triples or None in arm_triples:
        return {}
    feet = tree.places[[triple[2] for triple in leg_triples if triple]].mean(axis=0)
    up = unit(tree.places[chest] - feet)
    neck = max(others, key=lambda joint: (tree.places[joint] - tree.places[chest]) @ up + tree.reach[joint])
    forward = np.sum([_foot_direction(raw, tree, triple[2], up) for triple in leg_triples if triple], axis=0)
    if np.linalg.norm(forward) < 1e-9:
        return {}
    left = np.cross(up, forward)
    roles = {"pelvis": hips, "neck": neck}
    if len(path := tree.longest_path(neck)) > 1:
        roles["head"] = path[1]
    for triples, bodies in ((leg_triples, ("thigh", "shank", "foot")), (arm_triples, ("upper_arm", "forearm", "hand"))):
        middle = tree.places[[joint for triple in triples if triple for joint in triple]].mean(axis=0)
        for triple in triples:
            side = "l" if (tree.places[list(triple or ())].mean(axis=0) - middle) @ left > 0 else "r"
            roles |= {f"{side}_{body}": joint for body, joint in zip(bodies, triple or (), strict=True)}
    for side in "lr":
        upper = roles.get(f"{side}_upper_arm", hips)
        if tree.parents[upper] != chest and chest in ancestors(upper, tree.parents):
            roles[f"{side}_clavicle"] = tree.parents[upper]
    path = ancestors(neck, tree.parents)
    spine = list(reversed(path[: path.index(hips)]))
    return roles | {f"spine{number}": joint for number, joint in enumerate(spine)}


def _tree(raw: RawSkin) -> _Tree:
    count = len(raw.joint_names)
    children = tuple(tuple(c for c in range(count) if raw.joint_parents[c] == j) for j in range(count))
    reach = np.zeros(count)
    for joint in sorted(range(count), key=lambda j: -len(ancestors(j, raw.joint_parents))):
        steps = [np.linalg.norm(raw.joint_places[c] - raw.joint_places[joint]) + reach[c] for c in children[joint]]
        reach[joint] = max(steps, default=0.0)
    return _Tree(raw.joint_places, raw.joint_parents, children, reach)


def _pair(tree: _Tree, joint: int) -> tuple[int, int] | None:
    """Find the two longest limbs of equal length below a joint, of three joints or more each."""
    limbs = [
        child
        for child in tree.children[joint]
        if tree.length(child) > _SHORTEST_LIMB * tree.reach.max() and len(tree.longest_path(child)) >= 3
    ]
    best: tuple[float, tuple[int, int]] | None = None
    for number, a in enumerate(limbs):
        for b in limbs[number + 1 :]:
            longer, shorter = sorted((tree.length(a), tree.length(b)), reverse=True)
            steps = abs(len(tree.longest_path(a)) - len(tree.longest_path(b)))
            if longer - shorter < _SIMILAR * longer and steps <= 1:
                mismatch = (longer - shorter) / longer + steps
                best = min(best or (np.inf, (a, b)), (mismatch, (a, b)))
    return None if best is None else best[1]


def _to_the_hand(tree: _Tree, path: list[int]) -> list[int]:
    """Cut an arm where it branches into fingers."""
    for number, joint in enumerate(path[2:], start=2):
        if len(tree.children[joint]) >= 3:
            return path[: number + 1]
    return path


def _triple(tree: _Tree, path: list[int]) -> tuple[int, int, int] | None:
    """Choose the joints of a limb whose two bones are most nearly equal and make up most of it."""
    whole = sum(np.linalg.norm(tree.places[a] - tree.places[b]) for a, b in pairwise(path))
    best: tuple[float, tuple[int, int, int]] | None = None
    for i, upper in enumerate(path):
        for j in range(i + 1, len(path)):
            for lower in path[j + 1 :]:
                first = np.linalg.norm(tree.places[upper] - tree.places[path[j]])
                second = np.linalg.norm(tree.places[path[j]] - tree.places[lower])
                if first + second > 0.6 * whole and min(first, second) > 0:
                    imbalance = abs(np.log(first / second))
                    best = min(best or (np.inf, (0, 0, 0)), (float(imbalance), (upper, path[j], lower)))
    return None if best is None else best[1]


def _foot_direction(raw: RawSkin, tree: _Tree, ankle: int, up: np.ndarray) -> np.ndarray:
    """From the ankle towards the middle of the foot's vertices, along the ground."""
    foot = raw.weights[:, _below(tree, ankle)].sum(axis=1) > 0.5
    if not np.any(foot):
        return np.zeros(3)
    direction = raw.vertices[foot].mean(axis=0) - tree.places[ankle]
    return direction - (direction @ up) * up


def _below(tree: _Tree, joint: int) -> list[int]:
    found = [joint]
    for current in found:
        found.extend(tree.children[current])
    return found
