"""Captures on disk: videos with their timestamps, keypoints, masks and cameras, and checks before tracking."""

from ._capture import KEYPOINT_NAMES as KEYPOINT_NAMES, SILHOUETTES as SILHOUETTES, Capture as Capture
from ._check import check as check
from ._check_geometry import check_subject as check_subject, triangulated_people as triangulated_people
from ._check_videos import SYNC_REPORT as SYNC_REPORT
from ._check_views import check_common_size as check_common_size
from ._choose_frames import ChosenFrames as ChosenFrames, choose_frames as choose_frames
from ._config import (
    LONGEST_SIDE as LONGEST_SIDE,
    CaptureConfig as CaptureConfig,
    Finding as Finding,
    config_path as config_path,
    read_config as read_config,
)
from ._content import content_hash as content_hash, path_hash as path_hash
from ._detections import Detections as Detections
from ._edit_config import (
    with_cameras_line as with_cameras_line,
    with_keypoints_line as with_keypoints_line,
    with_lines as with_lines,
    with_offsets as with_offsets,
)
from ._flash import lit_apart as lit_apart, lit_by_flash as lit_by_flash
from ._picture_steps import (
    Undistortion as Undistortion,
    mask_file as mask_file,
    read_mask as read_mask,
    reduced_size as reduced_size,
)
from ._record import CaptureRecord as CaptureRecord
from ._span import shared_frames as shared_frames
from ._sync_plan import (
    SyncPlan as SyncPlan,
    camera_names as camera_names,
    new_capture_text as new_capture_text,
    plan_new_capture as plan_new_capture,
    plan_sync as plan_sync,
    refuse_single_pictures as refuse_single_pictures,
    video_names as video_names,
)
from ._video import (
    FrameReader as FrameReader,
    VideoIndex as VideoIndex,
    index_video as index_video,
)
from .synchronisation import (
    PersonHeights as PersonHeights,
    PersonOffset as PersonOffset,
    Synchronisation as Synchronisation,
    SyncMethod as SyncMethod,
    offset_by_person as offset_by_person,
    synchronise as synchronise,
)
