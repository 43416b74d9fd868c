"""What is read from a file of any format: joints that move, and the bodies that they are."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxmocap.character import Rig


class JointClip(NamedTuple):
    """`worlds` are the transforms of the rig's joints in the file's own world, lengths in its own units.

    The rig's places and rest transforms are in the same units. `up` is the world's vertical axis.
    """

    rig: Rig
    worlds: Float[np.ndarray, "frame joint 4 4"]
    timestamps: Float[np.ndarray, " frame"]
    up: str
