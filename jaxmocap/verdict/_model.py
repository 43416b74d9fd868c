"""How likely frames and limbs are wrong: two logistic regressions, fitted to films whose truth is known."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ._features import FRAME_FEATURES, LIMB_FEATURES

WRONG_FRAME, WRONG_LIMB = 0.08, 0.15
"""Metres: a frame is wrong beyond that in the mean over its joints, a limb at the worse of its two outer joints."""


class RiskModel(NamedTuple):
    """A logistic regression: the logit of a mistake is `intercept` + `weights` . features.

    No weight is negative but those of "alone" and "wide apart", so that nothing that looks worse is trusted more.

    Attributes:
        names: of the features.
        intercept: logit where all features are 0.
        weights: of the features, in their order.
        usual: features of right frames or limbs, in the mean: what is above it is a reason for doubt.
    """

    names: tuple[str, ...]
    intercept: float
    weights: tuple[float, ...]
    usual: tuple[float, ...]

    def logit(self, features: Float[np.ndarray, "*shape feature"]) -> Float[np.ndarray, "*shape"]:
        """Compute the logit of a mistake, -7 to 7: nothing is surer than one in a thousand."""
        return np.clip(self.intercept + features @ np.array(self.weights), -7.0, 7.0)

    def reasons(self, features: Float[np.ndarray, "*shape feature"]) -> dict[str, Float[np.ndarray, "*shape"]]:
        """Tell by name what of the logit is each feature's part, beyond what is usual where all is right."""
        parts = (features - np.array(self.usual)) * np.array(self.weights)
        return dict(zip(self.names, np.moveaxis(parts, -1, 0), strict=True))


def probability(logit: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Return the probability of a logit."""
    return 1.0 / (1.0 + np.exp(-logit))


FRAME_MODEL = RiskModel(
    FRAME_FEATURES, -3.126, (0.553, 0.998, 0.986, 0.986, 2.461, 6.455), (-0.162, 0.056, 0.223, 0.223, 0.278, 0.045)
)
LIMB_MODEL = RiskModel(LIMB_FEATURES, -2.605, (9.739, 2.241, 4.347, 0.792), (0.119, 0.195, 0.004, -1.271))
"""Fitted by `benchmarks/verdict_fit.py` to synthetic films, good ones and broken ones; the logits of frames are
stretched so that probabilities are those of other, harder films, four of five of them good ones. Not in the paper."""
