"""`jaxmocap segment`: the person's masks at the selected frames, to look at or to correct."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.table import Table

from ._arguments import CapturePath, Height, Json, PoseFile, Seed
from ._output import mask_words, progress, say, show, write_png
from ._register import refuse_if_taken

if TYPE_CHECKING:
    from jaxmocap.pipeline import MaskRecord


def segment(
    capture: CapturePath,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR", help="New folder for the masks and pictures of them.")],
    seed: Seed = 0,
    pose: PoseFile = None,
    height: Height = None,
    json: Json = False,
) -> int:
    """Find the person's outline at the selected frames, and write masks as a capture holds them and pictures."""
    import jax
    import numpy as np

    from jaxmocap._files import atomic_folder, write_json
    from jaxmocap.capture import Capture, mask_file
    from jaxmocap.pipeline import character_of, mask_record, with_person_masks, with_selected_frames
    from jaxmocap.registration import read_pose_file
    from jaxmocap.viewers import draw_mask

    refuse_if_taken(out)
    opened = Capture.open(capture).one_way_up()
    with progress() as report:
        character = character_of(opened, height=height, say=say, progress=report).character
    overrides = None if pose is None else read_pose_file(pose)
    opened, _ = with_selected_frames(opened, overrides, say)
    with atomic_folder(out) as folder, progress() as report:
        complete, found = with_person_masks(
            opened, character, key=jax.random.key(seed), overrides=overrides, say=say, progress=report
        )
        (folder / "masks").mkdir()
        for frame in complete.selected_frames or ():
            for camera, name in enumerate(complete.camera_names):
                mask, own = complete.mask(camera, frame), int(complete.video_frames[camera, frame])
                assert mask is not None
                recorded = np.where(complete.recorded_mask(camera, mask), 255, 0).astype(np.uint8)
                write_png(mask_file(folder / "masks", name, own), np.repeat(recorded[..., None], 3, axis=2))
                drawn = complete.as_filmed(camera, draw_mask(complete.image(camera, frame), mask))
                write_png(folder / f"overlay_{name}_{own:05d}.png", drawn)
        record = mask_record(opened, found)
        write_json(folder / "segmentation.json", record)
    show(record, lambda: _table(record, opened.camera_names, out), json_wanted=json)
    return 0


def _table(record: "MaskRecord", cameras: tuple[str, ...], out: Path) -> Table:
    table = Table(title=f"{out}: where masks come from, and confidence", title_justify="left")
    for column in ("Frame", *cameras):
        table.add_column(column, justify="right")
    for frame, row in record.items():
        table.add_row(frame, *(mask_words(row[name]) for name in cameras))
    return table
