"""The body on the viewer's page: a mesh for each status, so that a lost arm does not look like one that was seen."""

from typing import Any

import numpy as np

from jaxmocap.character import dominant_bodies
from jaxmocap.motion import Motion

from ._limb_trust import STATUS_COLOURS, body_status, faces_by_status

_LOST_OPACITY = 0.35  # of a part that nothing shows, over that of the rest


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


def add_mesh(server: Any, path: str, motion: Motion, colour: tuple[int, int, int]) -> Any:
    """Add a motion's mesh, as it is at first, in one colour."""
    faces = np.asarray(motion.character.faces)
    return server.scene.add_mesh_simple(path, motion.vertices(0), faces, color=colour, side="double")
