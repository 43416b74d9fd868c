"""Calibration of moving cameras from their videos: one metric COLMAP model with a pose per camera and frame."""

from ._calibrate import Calibration as Calibration, calibrate as calibrate
from ._in_place import (
    adopt_cameras as adopt_cameras,
    calibrate_in_place as calibrate_in_place,
    refine_cameras as refine_cameras,
)
from ._refine import RefinedCameras as RefinedCameras
from ._report import draw_cameras as draw_cameras, png_bytes as png_bytes
