import numpy as np
import pytest


@pytest.fixture(scope="module")
def street():
    """A textured synthetic background, a person-sized mask on it, and its image."""
    rng = np.random.default_rng(0)
    height, width = 120, 160
    y, x = np.mgrid[:height, :width]
    smooth = np.stack([0.3 + 0.3 * x / width, 0.4 + 0.2 * y / height, 0.35 + 0 * x], axis=-1)
    image = np.clip(smooth + rng.normal(size=smooth.shape) * 0.02, 0, 1)
    mask = (np.abs(x - 80) < 12) & (np.abs(y - 60) < 40)
    image[mask] = [0.9, 0.1, 0.1]
    return (image * 255).astype(np.uint8), mask
