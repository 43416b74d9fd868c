"""Viewers: the tracked body over the images, as pictures, sheets and videos, and the report page."""

from ._character_pictures import draw_character as draw_character, rig_pictures as rig_pictures
from ._overlay import (
    OverlayStyle as OverlayStyle,
    contact_sheet as contact_sheet,
    draw_mask as draw_mask,
    draw_overlay as draw_overlay,
    jpeg_bytes as jpeg_bytes,
    paint_face_ids as paint_face_ids,
)
from ._report_findings import findings as findings, headline as headline
from ._report_page import REPORT_PAGE as REPORT_PAGE, plain_page as plain_page, report_page as report_page
from ._rerun import write_rerun as write_rerun
from ._turntable import write_movie as write_movie
from ._video import (
    VideoWriter as VideoWriter,
    open_video as open_video,
    overlay_frames as overlay_frames,
    overlay_video as overlay_video,
    overlay_videos as overlay_videos,
    write_overlay_video as write_overlay_video,
)
from ._view import ResultViewer as ResultViewer, view as view
