"""From a card and its weights to a model that looks at pictures."""

from ._blazepose import LANDMARK_SHAPES, PERSON_SHAPES, BlazePose
from ._person_model import PersonModel
from ._runner import open_network
from ._weights import Weights


def open_model(weights: Weights) -> PersonModel:
    """Open the networks of a model, each family in its own way.

    Raises `InputError` where the runner is not installed or weights are not those of such a network.
    """
    match weights.card.family:
        case "blazepose":
            title, content = weights.card.title, weights.networks
            person = open_network(content["person"], f"the person detector of {title}", PERSON_SHAPES)
            landmarks = open_network(content["landmarks"], f"the landmark network of {title}", LANDMARK_SHAPES)
            return BlazePose(person, landmarks)
