"""The bodies on the viewer's page: a mesh for each status, so that a lost arm does not look like one that was seen, the
second result, and the truth."""

from typing import Any

import numpy as np
from jaxtyping import Float

from jaxmocap.character import dominant_bodies
from jaxmocap.motion import Motion

from ._limb_trust import STATUS_COLOURS, body_status, faces_by_status
from ._shown import Shown

_LOST_OPACITY = 0.35  # of a part that nothing shows, over that of the rest
_OTHER_COLOUR, _OTHER_BONES = (170, 120, 230), (80, 40, 130)
_TRUTH_COLOUR = (30, 160, 70)


class BodyView:
    """The mesh of a motion in up to three colours; `parts` are viser's handles by status."""

    def __init__(self, server: Any, path: str, motion: Motion):
        self._motion, self._drawn = motion, [""]
        self._face_bodies = dominant_bodies(motion.character)
        self.parts = {status: add_mesh(server, f"{path}/{status}", motion, c) for status, c in STATUS_COLOURS.items()}

    def draw(self, index: int, opacity: float, visible: bool) -> None:
        """Show the body at a position of the motion."""
        motion, status = self._motion, body_status(self._motion, index)
        if status != self._drawn:
            self._drawn = status
            for name, marked in faces_by_status(motion, index, self._face_bodies).items():
                self.parts[name].faces = np.asarray(motion.character.faces)[marked].astype(np.uint32)
        vertices = motion.vertices(index)
        for name, part in self.parts.items():
            part.visible = visible and opacity > 0 and name in status
            if name in status:
                part.vertices = vertices
                seen = opacity * (_LOST_OPACITY if name == "lost" else 1.0)
                part.opacity = None if seen >= 1 else seen


class SecondBody:
    """The second result, over the first or beside it."""

    def __init__(self, server: Any, shown: Shown, motion: Motion):
        self._shown, self._motion = shown, motion
        self.mesh = add_mesh(server, "/other/mesh", motion, _OTHER_COLOUR)
        points = shown.bones(motion, 0)
        self.bones = server.scene.add_line_segments("/other/skeleton", points, _OTHER_BONES, thickness=0.014)

    def draw(self, position: int, opacity: float, with_mesh: bool, with_bones: bool, beside: bool) -> None:
        """Show the body at a position of the first motion, if the second has that frame."""
        place = self._shown.other_at(position)
        self.mesh.visible, self.bones.visible = with_mesh and place is not None, with_bones and place is not None
        if place is None:
            return
        self.mesh.vertices = self._motion.vertices(place)
        self.mesh.opacity = None if opacity >= 1 else opacity
        self.bones.points = self._shown.bones(self._motion, place)
        for handle in (self.mesh, self.bones):
            handle.position = self._shown.aside() if beside else (0.0, 0.0, 0.0)


class TruePoints:
    """The true points, NaN where one is not known."""

    def __init__(self, server: Any, points: Float[np.ndarray, "frame point 3"]):
        self._points, nothing = points, np.zeros((1, 3), np.float32)
        self.cloud = server.scene.add_point_cloud(
            "/truth", nothing, _TRUTH_COLOUR, point_size=0.02, point_shape="circle"
        )

    def draw(self, index: int, visible: bool) -> None:
        """Show the points at a position of the motion."""
        points = self._points[index]
        points = points[np.isfinite(points).all(axis=1)].astype(np.float32)
        self.cloud.visible = visible and len(points) > 0
        if len(points):
            self.cloud.points = points


def add_mesh(server: Any, path: str, motion: Motion, colour: tuple[int, int, int]) -> Any:
    """Add a motion's mesh, as it is at first, in one colour."""
    faces = np.asarray(motion.character.faces)
    return server.scene.add_mesh_simple(path, motion.vertices(0), faces, color=colour, side="double")
