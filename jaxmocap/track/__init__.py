"""Tracking: registration at the selected frames, then search and refinement frame by frame."""

from ._checkpoint import Checkpoint as Checkpoint
from ._clock import Clock as Clock
from ._confidence import Verdict as Verdict, VerdictSettings as VerdictSettings, judge as judge
from ._economy import Calm as Calm, Hindsight as Hindsight, Retry as Retry
from ._fit_character import (
    CharacterFit as CharacterFit,
    CharacterFitSettings as CharacterFitSettings,
    fit_character as fit_character,
)
from ._frame import FrameTracker as FrameTracker
from ._frame_result import FrameResult as FrameResult
from ._inverse_kinematics import inverse_kinematics as inverse_kinematics, triangulated as triangulated
from ._least_squares import Prior as Prior, Rows as Rows, descend as descend, free_prior as free_prior
from ._lost import LostSpan as LostSpan, lost_spans as lost_spans
from ._odd_camera import OddCamera as OddCamera, odd_cameras as odd_cameras
from ._past import Past as Past
from ._polish import PolishPlan as PolishPlan, polish as polish
from ._register import (
    Overrides as Overrides,
    Registration as Registration,
    RegistrationSettings as RegistrationSettings,
    apply_overrides as apply_overrides,
    draw as draw,
    fit_to_masks as fit_to_masks,
    frame_rectangle as frame_rectangle,
    intersection_over_union as intersection_over_union,
    read_pose_file as read_pose_file,
    register as register,
    register_frame as register_frame,
)
from ._search import (
    GroupSearch as GroupSearch,
    Stage as Stage,
    group_searches as group_searches,
    initial_spread as initial_spread,
)
from ._segment import (
    PersonMask as PersonMask,
    PersonMasks as PersonMasks,
    SegmentationSettings as SegmentationSettings,
    masks_of as masks_of,
    segment_person as segment_person,
)
from ._sequence import (
    Method as Method,
    Progress as Progress,
    key_poses_of as key_poses_of,
    motion_of as motion_of,
    observe as observe,
    track as track,
    track_frames as track_frames,
)
from ._settings import with_settings as with_settings
from ._shape_problem import ShapePrior as ShapePrior
from ._signals import FrameSignals as FrameSignals
from ._surface_flow import FlowSettings as FlowSettings, Source as Source, surface_flow as surface_flow
from ._tracker import (
    DetectionPlan as DetectionPlan,
    Effort as Effort,
    Quality as Quality,
    RefinePlan as RefinePlan,
    RefineWeights as RefineWeights,
    SearchPlan as SearchPlan,
    Tracker as Tracker,
    appearance_preset as appearance_preset,
)
from ._uncertainty import UncertaintySettings as UncertaintySettings, joint_covariances as joint_covariances
from ._verdict import Doubt as Doubt, doubts as doubts
