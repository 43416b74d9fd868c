"""Which parts of the body a result trusts in a frame: what is drawn as found, as doubtful, and as lost or hidden."""

import numpy as np
from jaxtyping import Bool, Int

from jaxmocap.motion import Motion
from jaxmocap.verdict import VerdictSettings

STATUS_COLOURS = {"ok": (70, 170, 255), "doubtful": (255, 160, 30), "lost": (235, 60, 60)}
_DOUBTFUL = VerdictSettings().confidence  # what a landmark of a doubtful frame has at most


def body_status(motion: Motion, index: int) -> list[str]:
    """Judge every body of the skeleton at a position: "ok", "doubtful", or "lost", which hidden parts are too.

    A part that was lost has confidence 0 and one that is doubtful at most that of a doubtful frame (`VerdictSettings`).
    The frame's own status is the least that is said of each; a frame without any confidence says only that.
    """
    frame = str(motion.status[index])
    bodies = np.asarray(motion.confidence[index])[: len(motion.character.skeleton.body_names)]
    if frame == "lost" or not bodies.any():
        return [frame] * len(bodies)
    known = ["lost" if value <= 0 else "doubtful" if value <= _DOUBTFUL else "ok" for value in bodies]
    return ["doubtful" if frame == "doubtful" and one == "ok" else one for one in known]


def faces_by_status(
    motion: Motion, index: int, face_bodies: Int[np.ndarray, " face"]
) -> dict[str, Bool[np.ndarray, " face"]]:
    """Sort the mesh's faces by the status of the bodies that move them (`dominant_bodies`)."""
    status = np.array(body_status(motion, index))[face_bodies]
    return {name: status == name for name in STATUS_COLOURS}


def words_about(motion: Motion, index: int) -> str:
    """Say the status of a frame, and of the parts that are lost in it and why."""
    frame = int(motion.frames[index])
    spans = motion.provenance.get("lost") or []
    parts = [f"{s['part']}: {s['why']}" for s in spans if s["part"] != "body" and s["first"] <= frame <= s["last"]]
    return "; ".join([str(motion.status[index]), *parts])
