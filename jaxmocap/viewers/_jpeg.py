"""A picture as the bytes of a JPEG, for pages that hold their pictures."""

import cv2
import numpy as np
from jaxtyping import UInt8


def jpeg_bytes(image: UInt8[np.ndarray, "height width 3"], quality: int = 85) -> bytes:
    """An RGB picture as JPEG."""
    done, data = cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality])
    assert done
    return data.tobytes()
