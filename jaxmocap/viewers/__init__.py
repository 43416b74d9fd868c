"""Viewers: the tracked body over the images, as pictures, sheets and videos, and the report page."""

from ._character_picture import draw_character as draw_character
from ._faces import paint_face_ids as paint_face_ids
from ._jpeg import jpeg_bytes as jpeg_bytes
from ._mask_picture import draw_mask as draw_mask
from ._overlay import OverlayStyle as OverlayStyle, contact_sheet as contact_sheet, draw_overlay as draw_overlay
from ._overlay_video import (
    overlay_frames as overlay_frames,
    overlay_video as overlay_video,
    overlay_videos as overlay_videos,
)
from ._report_page import report_page as report_page
from ._rerun import write_rerun as write_rerun
from ._rig_pictures import rig_pictures as rig_pictures
from ._video import VideoWriter as VideoWriter, open_video as open_video, write_overlay_video as write_overlay_video
from ._view import ResultViewer as ResultViewer, view as view
