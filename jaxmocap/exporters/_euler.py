"""Euler angles that stay away from gimbal lock and do not jump."""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

ORDERS = (("ZXY",), ("ZYX", "XYZ", "YXZ"), ("XZY", "YZX"))
"""Orders of axes: one that every program reads, those that most do, and the rest."""
_NEAR_LOCK = np.radians(70.0)


def best_order(matrices: Float[np.ndarray, "frame 3 3"]) -> str:
    """The order of turning whose middle angle stays farthest from a quarter turn, at which the other two axes fall
    together (gimbal lock). A more common order is taken wherever it keeps 20 degrees away from that."""
    rotations = Rotation.from_matrix(matrices)
    reach: dict[str, float] = {}
    for orders in ORDERS:
        reach |= {order: float(np.abs(_angles(rotations, order)[:, 1]).max()) for order in orders}
        best = min(reach, key=reach.__getitem__)
        if reach[best] < _NEAR_LOCK:
            break
    return best


def euler_angles(matrices: Float[np.ndarray, "frame 3 3"], order: str) -> Float[np.ndarray, "frame 3"]:
    """Radians about the axes of `order`, each axis turned by the ones before it: R = R1 R2 R3. Of the two sets of
    angles, and of whole turns, each frame takes those next to the frame before."""
    angles = _angles(Rotation.from_matrix(matrices), order)
    for frame in range(1, len(angles)):
        before, now = angles[frame - 1], angles[frame]
        twin = np.array([now[0] + np.pi, np.pi - now[1], now[2] + np.pi])
        near = [values - 2 * np.pi * np.round((values - before) / (2 * np.pi)) for values in (now, twin)]
        angles[frame] = min(near, key=lambda values: np.abs(values - before).sum())
    return angles


def _angles(rotations: Rotation, order: str) -> np.ndarray:
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # in gimbal lock the third angle is 0: right, if not unique
        return rotations.as_euler(order)
