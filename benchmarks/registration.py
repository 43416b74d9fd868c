"""How far registered poses are from the truth, over many frames of a capture: everything that is tracked follows them.

    python benchmarks/registration.py ../shared/data/street --frames 0:35:4 --keypoints DETECTED --out FIGURES.json

The character is registered at each of these frames from its keypoints (those of the capture, or a folder that
`jaxmocap detect` wrote) and its masks, found where the capture has none; comparable joints are held against the truth.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import jaxmocap

jaxmocap.configure()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from figures import add_options, finish, record  # noqa: E402

from jaxmocap.capture import Capture  # noqa: E402
from jaxmocap.character import Character, Pose  # noqa: E402
from jaxmocap.metrics import COMPARABLE, Truth  # noqa: E402
from jaxmocap.motion import Motion  # noqa: E402
from jaxmocap.pipeline import open_character, with_person_masks  # noqa: E402
from jaxmocap.registration import RegistrationSettings, register  # noqa: E402


def joint_errors(capture: Capture, character: Character, poses: dict[int, Pose]) -> np.ndarray:
    """Measure how far comparable joints are from the truth, (frame, joint), centimetres."""
    frames = np.array(list(poses))
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *poses.values())
    motion = Motion.from_poses(character, stacked, capture.video_frames[0, frames], capture.timestamps[frames])
    truth, motion = Truth.read(capture.truth).at(motion)
    ours = character.skeleton.landmark_names
    names = [name for name in COMPARABLE if name in ours and name in truth.joint_names]
    here, there = [ours.index(name) for name in names], [truth.joint_names.index(name) for name in names]
    return 100 * np.linalg.norm(motion.joints[:, here] - truth.joints[:, there], axis=-1)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path, help="a capture folder with an actor and a truth")
    parser.add_argument("--frames", help="START:STOP:STEP; default: the selected frames")
    parser.add_argument("--keypoints", type=Path, help="a folder of a detector's files, instead of the capture's")
    parser.add_argument("--find-masks", action="store_true", help="find the person, whatever masks the capture has")
    parser.add_argument("--rounds", type=int, default=RegistrationSettings().view_flow, help="between the views")
    parser.add_argument("--seed", type=int, default=0)
    add_options(parser)
    options = parser.parse_args()
    capture, key = Capture.open(options.capture), jax.random.key(options.seed)
    if capture.truth is None:
        parser.error(f"capture '{capture.name}' has no truth, against which its poses could be held.")
    if options.keypoints is not None:
        capture = capture.with_keypoints_folder(options.keypoints.resolve())
    if options.find_masks:
        capture = replace(capture, masks_folder=None)
    if options.frames:
        capture = capture.with_selected_frames(tuple(range(*map(int, options.frames.split(":")))))
    character = open_character(capture)
    capture, _ = with_person_masks(capture, character, key=jax.random.fold_in(key, 4))
    settings = RegistrationSettings(view_flow=options.rounds)
    found = register(capture, capture.cameras, character, key=jax.random.fold_in(key, 1), settings=settings)
    errors = joint_errors(capture, character, {frame: one.pose for frame, one in found.items()})
    figures = [
        record("joints, mean", errors.mean(), "cm", 0.1),
        record("joints, 95th percentile", np.percentile(errors, 95), "cm", 0.15),
        record("joints, worst frame", errors.mean(1).max(), "cm", 0.15),
        record("overlap with the masks", np.nanmean([one.iou for one in found.values()]), "", 0.02, "higher"),
    ]
    return finish(figures, options, capture=capture.name, frames=len(found), rounds=options.rounds)


if __name__ == "__main__":
    sys.exit(main())
