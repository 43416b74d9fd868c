"""Keypoints set by hand, and a detector's corrected, on a page that is served to this machine alone."""

from ._annotate import AnnotationPage as AnnotationPage, annotate as annotate
from ._editor import KeypointEditor as KeypointEditor
from ._epipolar import EpipolarGeometry as EpipolarGeometry, epipolar_segment as epipolar_segment
