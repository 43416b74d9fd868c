"""Somebody who walks past behind the actor, whom a tracker has to leave alone."""

import numpy as np
from jaxtyping import Float

from ._actor import make_actor, posed
from ._body import TEMPLATE_HEIGHT
from ._clothes import Outfit
from ._motion import perform
from ._render import Subject

_BEHIND = (0.8, 2.0)
_PACE = (0.7, 1.4)


def passing(
    seed: int, times: Float[np.ndarray, "frame"], path: Float[np.ndarray, "frame 3"]
) -> tuple[Subject, Float[np.ndarray, "frame vertex 3"]]:
    """Make somebody who walks past behind where the actor is halfway, and their vertices at all times (seconds).

    `path` are the actor's places on the ground. They step and swing their arms as the dancer does, in clothes of other
    colours.
    """
    rng = np.random.default_rng([seed, 8])
    height, ahead = rng.uniform(1.55, 1.9), rng.choice([-1.0, 1.0])
    person = make_actor(height)
    vertices, _ = posed(person, perform("dance", person.skeleton, times + rng.uniform(5, 15), 0.6))
    middle = path[len(path) // 2] - np.array([0.0, 0.0, rng.uniform(*_BEHIND)])
    along = rng.uniform(-0.5, 0.5) + rng.uniform(*_PACE) * (times - times.mean())
    way = middle + ahead * along[:, None] * np.array([1.0, 0.0, 0.0])
    facing = np.array([[0.0, 0.0, ahead], [0.0, 1.0, 0.0], [-ahead, 0.0, 0.0]])  # they walk to where they look
    rest = np.asarray(person.vertices, np.float32) * np.float32(TEMPLATE_HEIGHT / height)
    style = ("patterned", "uniform", "plain sleeves")[rng.integers(3)]
    outfit = Outfit.make(seed + 1000, style, ((2, 0, 1), (1, 2, 0), (1, 0, 2))[rng.integers(3)])
    turned = vertices @ facing.T + way[:, None]
    return Subject(rest, np.asarray(person.faces), outfit), turned
