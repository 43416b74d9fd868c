"""The rotation from a file's axes to the rest frame: x = subject's left, y up, z forward."""

import itertools

import numpy as np


def rest_frame(places: dict[str, np.ndarray], near: float = 20.0) -> np.ndarray:
    """Rotation (3, 3), rest frame from file frame, from joint positions; an exact quarter turn where one is within
    `near` degrees.

    Up is from the ankles to the neck, left from the right hip and shoulder to the left ones.
    """
    ankles = 0.5 * (places["l_ankle"] + places["r_ankle"])
    up = _unit(places["neck"] - ankles)
    left = sum(_unit(places[f"l_{name}"] - places[f"r_{name}"]) for name in ("hip", "shoulder"))
    left = _unit(left - (left @ up) * up)
    estimate = np.stack([left, up, np.cross(left, up)])
    for turn in _quarter_turns():
        if np.all(np.sum(turn * estimate, axis=1) > np.cos(np.radians(near))):
            return turn
    return estimate


def _quarter_turns() -> list[np.ndarray]:
    turns = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            turn = np.diag(signs)[:, list(order)]
            if np.linalg.det(turn) > 0:
                turns.append(turn)
    return turns


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(np.linalg.norm(vector), 1e-12)
