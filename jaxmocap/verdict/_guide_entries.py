"""Under which heading of the guide each reason of a verdict is explained."""

from . import _doubts, _lost, _outlier_camera

GUIDE_ENTRIES = {
    _doubts.APART: "The views disagree",
    _doubts.OUTLINE: "The outline does not fit",
    _doubts.UNEXPLAINED: "The pixels do not look like the person",
    _doubts.FAST: "The body moves too fast",
    _doubts.UNTOLD: "The pictures tell too little",
    _doubts.ALONE: "No two views can be compared",
    _doubts.REGISTERED: "A selected frame is wrong",
    _lost.LOST: "The body is lost",
    _lost.HIDDEN: "No view shows a limb",
    _lost.FOREIGN: "A limb looks like the background",
    _lost.JUMPING: "A limb leaves its way",
    _outlier_camera.ALONE: "A camera is left out",
}
"""Heading by reason, as `why` of a span has it; headings of `docs/guide.md`."""
