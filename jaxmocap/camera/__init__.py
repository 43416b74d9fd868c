"""Cameras: calibrated views per frame, projection, triangulation, and calibration files."""

from ._cameras import (
    Cameras as Cameras,
    View as View,
    pixel_rays as pixel_rays,
    project as project,
    triangulate as triangulate,
)
from ._colmap import colmap_files as colmap_files
from ._colmap_cameras import ranges as ranges, write_colmap_text as write_colmap_text
from ._colmap_points import read_colmap_points as read_colmap_points
from ._read import (
    examine_cameras as examine_cameras,
    read_cameras as read_cameras,
    read_picture_cameras as read_picture_cameras,
)
from ._view_geometry import (
    ViewGeometry as ViewGeometry,
    describe_views as describe_views,
    look_at_point as look_at_point,
    view_angles as view_angles,
    view_geometry as view_geometry,
    world_from_upright as world_from_upright,
)
from ._write import FORMATS as FORMATS, write_cameras as write_cameras
