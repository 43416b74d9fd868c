"""Captures on disk: videos with their timestamps, keypoints, masks and cameras, and checks before tracking."""

from ._capture import Capture as Capture
from ._check import check as check
from ._check_geometry import check_subject as check_subject
from ._choose_frames import ChosenFrames as ChosenFrames, choose_frames as choose_frames
from ._detections import Detections as Detections
from ._findings import Finding as Finding
from ._keypoints import KEYPOINT_NAMES as KEYPOINT_NAMES, mask_file as mask_file
from ._sync_plan import SyncPlan as SyncPlan, plan_new_capture as plan_new_capture, plan_sync as plan_sync
from .synchronisation import Synchronisation as Synchronisation, SyncMethod as SyncMethod, synchronise as synchronise
