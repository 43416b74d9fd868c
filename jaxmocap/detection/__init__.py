"""A detector's keypoints: layouts of points as data, and readers of the files that programs write."""

from ._files import VideoKeypoints as VideoKeypoints
from ._layouts import (
    BODY_25 as BODY_25,
    LAYOUTS as LAYOUTS,
    Layout as Layout,
    LayoutName as LayoutName,
    to_body_25 as to_body_25,
)
from ._read import best_person as best_person, read_people as read_people, read_video as read_video
