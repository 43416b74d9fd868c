"""Calibration of moving cameras from their videos: one metric COLMAP model with a pose per camera and frame.

`_calibrate` goes from `_footage` to a model in a child process (`_child` runs `_worker`: `_features`, `_matching`,
`_mapping`, `_registration`, `_trajectory`, `_repair`, `_uncertainty`), from there by `_subject` and `_scale` to the
metric `_world`, and to the `_report`. `_refine` improves cameras with the tracked body: `_sightings` make a
`_joint_scene`, which `_joint_adjustment` solves. `_in_place` does either to a capture on disk. `_pictures` are single
ones, of a scan.
"""

from ._calibrate import (
    Calibration as Calibration,
    calibrate as calibrate,
    check_camera_distance as check_camera_distance,
    refuse_gaps as refuse_gaps,
)
from ._focal import PHONE_FOCAL as PHONE_FOCAL, level_camera as level_camera, usual_focal as usual_focal
from ._in_place import (
    adopt_cameras as adopt_cameras,
    calibrate_in_place as calibrate_in_place,
    refine_cameras as refine_cameras,
    scale_cameras as scale_cameras,
    scale_in_place as scale_in_place,
)
from ._pictures import PlacedPictures as PlacedPictures, calibrate_pictures as calibrate_pictures
from ._refine import RefinedCameras as RefinedCameras
from ._report import draw_cameras as draw_cameras, png_bytes as png_bytes
from ._scale import Scale as Scale, fit_scale as fit_scale
from ._subject import (
    PARTS_OF_HEIGHT as PARTS_OF_HEIGHT,
    SubjectView as SubjectView,
    triangulate_views as triangulate_views,
)
