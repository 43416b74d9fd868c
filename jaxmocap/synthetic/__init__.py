"""A built-in capture without data: a procedural actor, scene, motion and renderer, for the demo and the tests."""

from ._actor import actor_skeleton as actor_skeleton, make_actor as make_actor
from ._cameras import (
    filming_distance as filming_distance,
    handheld_paths as handheld_paths,
    intrinsics_of as intrinsics_of,
)
from ._capture import SyntheticCapture as SyntheticCapture, body_25 as body_25, make_capture as make_capture
from ._clothes import Outfit as Outfit, Subject as Subject
from ._motion import Routine as Routine, dance as dance, perform as perform, stand as stand
from ._render import Rendered as Rendered, develop as develop, render_view as render_view
from ._scene import Scene as Scene, Scenery as Scenery, make_scene as make_scene
from ._write import write_capture as write_capture
