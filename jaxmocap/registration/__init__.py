"""Registration at the selected frames (sec. 3.2): poses, masks, and a character made to measure."""

from ._character_fit import CharacterFit as CharacterFit, CharacterFitSettings as CharacterFitSettings
from ._fit_character import (
    FEWEST_FRAMES as FEWEST_FRAMES,
    fit_character as fit_character,
    measurable as measurable,
    usable_frames as usable_frames,
)
from ._fit_silhouette import (
    RegistrationSettings as RegistrationSettings,
    fit_to_masks as fit_to_masks,
)
from ._fit_surface import SurfaceFit as SurfaceFit, SurfaceSettings as SurfaceSettings, fit_surface as fit_surface
from ._inverse_kinematics import inverse_kinematics as inverse_kinematics, triangulated as triangulated
from ._pose_file import Overrides as Overrides, apply_overrides as apply_overrides, read_pose_file as read_pose_file
from ._register import Registration as Registration, register as register, register_frame as register_frame
from ._segment import (
    PersonMask as PersonMask,
    PersonMasks as PersonMasks,
    SegmentationSettings as SegmentationSettings,
    masks_of as masks_of,
    segment_person as segment_person,
)
from ._shape_problem import ShapePrior as ShapePrior
