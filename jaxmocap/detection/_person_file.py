"""The file of one person's keypoints in a video: MMPose's form, with what else a detector said beside it."""

import json
from pathlib import Path

import numpy as np

from jaxmocap._files import write_text
from jaxmocap._results import InputError

from ._follow import FollowedPerson


def write_person(file: Path, person: FollowedPerson) -> None:
    """Write a person, atomically.

    Readers of MMPose's form take `keypoints` and `keypoint_scores`; beside them lie `detector_scores`, the confidences
    before any were lowered, and `side`, the region's (pixels).
    """
    lines = []
    for row, frame in enumerate(person.frames):
        instance = {
            "keypoints": np.round(person.points[row, :, :2], 2).tolist(),
            "keypoint_scores": np.round(person.points[row, :, 2], 3).tolist(),
            "detector_scores": np.round(person.scores[row], 3).tolist(),
            "side": round(float(person.sides[row]), 1),
        }
        lines.append(json.dumps({"frame_id": int(frame), "instances": [instance] if person.found[row] else []}))
    write_text(file, "[\n" + ",\n".join(lines) + "\n]\n")


def read_person(file: Path) -> FollowedPerson:
    """Read what `write_person` wrote. Raises `InputError` for other files."""
    try:
        rows = json.loads(file.read_text(encoding="utf-8"))
        frames = np.array([int(row["frame_id"]) for row in rows], np.int64)
        found = [row["instances"][0] if row["instances"] else None for row in rows]
        count = max((len(one["keypoint_scores"]) for one in found if one), default=0)
        points, scores, sides = np.zeros((len(rows), count, 3)), np.zeros((len(rows), count)), np.zeros(len(rows))
        for row, one in enumerate(found):
            if one is not None:
                points[row] = np.column_stack([one["keypoints"], one["keypoint_scores"]])
                scores[row], sides[row] = one["detector_scores"], one["side"]
    except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
        raise InputError(f"{file} is not as detect wrote it ({error}); remove it and detect again") from None
    return FollowedPerson(frames, points, scores, sides, ())
