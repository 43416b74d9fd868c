"""A run in which stand-ins (`done` of the conftest) take the place of the stages, and its keypoints."""

import json
from pathlib import Path

from jaxmocap.pipeline import RunResult, run

STAGES = ["capture", "synchronise", "detect", "calibrate", "body", "selected frames", "track"]
VIDEO = json.dumps([{"frame_id": 1, "instances": [{"keypoints": [[20, 20]] * 17, "keypoint_scores": [0.9] * 17}]}])


def again(clips, out, **options) -> tuple[RunResult, list[str]]:
    """Run; the result, and the stages that were done, which are those that the plan said."""
    planned: list[str] = []

    def note(stages) -> None:
        planned.extend(stage.name for stage in stages if stage.state in ("to do", "again"))

    result = run(clips, out, plan=note, **({"height": 1.8} | options))
    assert list(result.seconds) == planned
    return result, planned


def make_folder(folder: Path) -> Path:
    folder.mkdir()
    return folder
