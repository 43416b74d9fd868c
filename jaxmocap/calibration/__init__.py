"""Calibration of moving cameras from their videos: one metric COLMAP model with a pose per camera and frame."""

from ._adopt import adopt_cameras as adopt_cameras
from ._calibrate import Calibration as Calibration, calibrate as calibrate
from ._in_place import calibrate_in_place as calibrate_in_place
from ._picture import draw_cameras as draw_cameras, png_bytes as png_bytes
from ._refine import RefinedCameras as RefinedCameras
from ._refine_in_place import refine_cameras as refine_cameras
