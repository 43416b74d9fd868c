"""Cameras: calibrated views per frame, projection, triangulation, and calibration files."""

from ._cameras import Cameras as Cameras, View as View
from ._projection import pixel_rays as pixel_rays, project as project, triangulate as triangulate
