"""Importers: clips of other programs as motions of our characters."""

from ._bvh import read_bvh as read_bvh
from ._glb import read_glb as read_glb
from ._read_motion import read_motion as read_motion
