"""Packed integer z-buffer keys: quantised inverse depth in the high bits, face number in the low bits.

`max` of two keys keeps the nearer face, ties go to the larger face number, so every driver that applies the same keys
in any order ends with the same buffer, bit for bit.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

WINDOW = 8
"""Side of the square pixel windows that a face is split into; also the border kept around every key buffer."""


class KeyLayout(eqx.Module):
    """How many of the 31 usable bits hold the face number. 5,000 faces need 13, which leaves 18 for the depth."""

    id_bits: int = eqx.field(static=True)

    @staticmethod
    def for_faces(num_faces: int) -> "KeyLayout":
        """Choose the layout for a mesh.

        Raises `ValueError` above 500,000 faces (the depth would keep fewer than 12 bits).
        """
        bits = max(4, int(num_faces + 1).bit_length())
        if bits > 19:
            raise ValueError(
                f"{num_faces} faces leave too few bits for the depth; simplify the mesh to 500,000 or fewer"
            )
        return KeyLayout(bits)

    @property
    def id_mask(self) -> int:
        return (1 << self.id_bits) - 1

    @property
    def empty(self) -> int:
        """Key of a pixel that no face covers."""
        return self.id_mask

    @property
    def depth_levels(self) -> int:
        return 2 ** (31 - self.id_bits) - 2

    def face(self, keys: Int[Array, "*shape"]) -> Int[Array, "*shape"]:
        """Read the face number per pixel, -1 where empty."""
        ids = keys & self.id_mask
        return jnp.where(ids == self.id_mask, -1, ids)

    def inverse_depth(self, keys: Int[Array, "*shape"], depth_range: Float[Array, "2"]) -> Float[Array, "*shape"]:
        """Read the inverse depth (1/metres) per pixel; `depth_range[0]` where empty."""
        level = (keys >> self.id_bits).astype(jnp.float32)
        return jnp.maximum(level - 1.0, 0.0) * ((depth_range[1] - depth_range[0]) / self.depth_levels) + depth_range[0]


def empty_buffer(layout: KeyLayout, height: int, width: int) -> Int[Array, "padded_height padded_width"]:
    """Make a key buffer with nothing in it, `WINDOW` pixels of border on every side."""
    return jnp.full((height + 2 * WINDOW, width + 2 * WINDOW), layout.empty, jnp.int32)


def crop(buffer: Int[Array, "*lead padded_height padded_width"]) -> Int[Array, "*lead height width"]:
    """Cut off the border of a buffer."""
    return buffer[..., WINDOW:-WINDOW, WINDOW:-WINDOW]
