"""`jaxmocap register`: the poses at the selected frames alone, to look at before tracking."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.table import Table

from jaxmocap._results import InputError

from ._arguments import ActorFile, CapturePath, FindMasks, Height, Json, PoseFile, Seed
from ._output import mask_words, progress, say, show, write_png

if TYPE_CHECKING:
    from jaxmocap.camera import Cameras
    from jaxmocap.capture import Capture
    from jaxmocap.character import Character
    from jaxmocap.registration import Registration


def register(
    capture: CapturePath,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR", help="New folder for registration.json and the pictures.")],
    seed: Seed = 0,
    pose: PoseFile = None,
    find_masks: FindMasks = True,
    actor: ActorFile = None,
    height: Height = None,
    json: Json = False,
) -> int:
    """Fit the actor at the selected frames and draw it over them, to look at before tracking."""
    import jax

    from jaxmocap._files import atomic_folder, write_json
    from jaxmocap.capture import Capture
    from jaxmocap.pipeline import (
        character_of,
        mask_record,
        registration_record,
        with_person_masks,
        with_selected_frames,
    )
    from jaxmocap.registration import read_pose_file, register

    refuse_if_taken(out)
    filmed = Capture.open(capture)
    opened = filmed.one_way_up()
    with progress() as report:
        character = character_of(opened, actor, height, say=say, progress=report).character
    cameras = opened.cameras
    overrides = None if pose is None else read_pose_file(pose)
    opened, _ = with_selected_frames(opened, overrides, say)
    selected = opened.selected_frames or (0,)
    with atomic_folder(out) as folder, progress() as report:
        key = jax.random.key(seed)
        opened, masks = with_person_masks(
            opened, character, key=key, overrides=overrides, find=find_masks, say=say, progress=report
        )
        register_key = jax.random.fold_in(key, 1)
        found = register(opened, cameras, character, selected, key=register_key, overrides=overrides, progress=report)
        for registration in found.values():
            _draw(filmed, filmed.cameras, character, registration, folder)
        record = registration_record(found, character, mask_record(opened, masks))
        write_json(folder / "registration.json", record)
    show(record, lambda: _table(record, opened.camera_names, out), json_wanted=json)
    return 0


def refuse_if_taken(out: Path) -> None:
    """Refuse an output that is not a new or an empty folder."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out} exists already; choose a new or an empty folder with --out.")


def _draw(capture: "Capture", cameras: "Cameras", character: "Character", found: "Registration", folder: Path) -> None:
    import numpy as np

    from jaxmocap.character import landmark_positions, skin
    from jaxmocap.viewers import draw_overlay

    view = cameras.at(found.frame)
    vertices, faces = np.asarray(skin(character, found.pose)), np.asarray(character.faces)
    joints = np.asarray(landmark_positions(character.skeleton, found.pose))
    for camera, name in enumerate(cameras.names):
        own = capture.video_frames[camera, found.frame]
        picture = draw_overlay(
            capture.image(camera, found.frame),
            vertices,
            faces,
            np.asarray(view.intrinsics[camera]),
            np.asarray(view.cam_from_world[camera]),
            joints=joints,
            joint_names=character.skeleton.landmark_names,
            label=f"{name}  frame {own}",
        )
        write_png(folder / f"overlay_{name}_{own:05d}.png", picture)


def _table(record: dict[str, Any], cameras: tuple[str, ...], out: Path) -> Table:
    table = Table(title=str(out), title_justify="left")
    for column in ("Frame", *(f"overlap {name}" for name in cameras), "keypoints, cm", "searched", "masks"):
        table.add_column(column, justify="right")
    for frame, found in record.items():
        rms = found["keypoint_rms_m"]
        table.add_row(
            frame,
            *("" if iou is None else f"{iou:.3f}" for iou in found["iou"]),
            "" if rms is None else f"{100 * rms:.1f}",
            "yes" if found["searched"] else "no",
            ", ".join(mask_words(entry) for entry in found["masks"].values()),
        )
    return table
