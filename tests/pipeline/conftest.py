"""Two videos, and stand-ins for the stages of `run`, which have tests of their own."""

import json
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from small_captures import make_video

from jaxmocap.capture import Capture, config_path, with_lines, with_offsets
from jaxmocap.character import Pose
from jaxmocap.motion import Motion
from jaxmocap.pipeline import _run_files, _run_footage, _run_work
from jaxmocap.pipeline._made_to_measure import MadeBody
from jaxmocap.rigging import body


@pytest.fixture(scope="module")
def clips(tmp_path_factory) -> list[Path]:
    """Two small videos, one upright and one lying; nobody is in them."""
    folder = tmp_path_factory.mktemp("videos")
    return [make_video(folder / "left.mp4"), make_video(folder / "right hand.mp4", size=(48, 64))]


@pytest.fixture(scope="module")
def motion() -> Motion:
    character = body()
    poses = Pose(jnp.stack([jnp.eye(4)] * 2), jnp.zeros((2, character.skeleton.num_angles)))
    provenance = {"lost": [], "outlier_cameras": [], "doubts": [], "seconds_per_frame": 1.0}
    return Motion.from_poses(character, poses, np.arange(2), np.array([0.0, 0.04]), provenance=provenance)


@pytest.fixture
def done(monkeypatch, motion) -> list[str]:
    """The stages that are done, in order; each stand-in writes into the capture folder what its stage would."""
    names: list[str] = []

    def set_lines(folder: Path, **lines) -> None:
        file = config_path(folder)
        file.write_text(with_lines(file.read_text(), lines, file))

    def sync(folder, progress):
        names.append("synchronise")
        file = config_path(folder)
        file.write_text(with_offsets(file.read_text(), [0.0] * file.read_text().count("[[camera]]"), file))
        record = {"cameras": {"left": {"offset_frames": 0.0}}, "pairs": [{"used": "sound"}]}
        return SimpleNamespace(notes=("the sound says so",), record=lambda: record)

    def detect(folder, **options):
        names.append("detect")
        (folder / "keypoints").mkdir(exist_ok=True)
        (folder / "keypoints" / "left.json").write_text(json.dumps(sorted(options["person"].items())))
        (folder / "detection.json").write_text("{}")
        set_lines(folder, keypoints="keypoints")
        return SimpleNamespace(folder=folder / "keypoints")

    def calibrate(folder, say, naming, **options):
        names.append("calibrate")
        cameras = _run_footage.free_name(folder, "cameras")
        cameras.mkdir()
        (cameras / "height").write_text(str(options["height"]))
        (cameras / "distance").write_text(str(options["camera_distance"]))
        (cameras / "static").write_text(str(options["static"]))
        lost = {"left": {"interpolated": []}, "right_hand": {"interpolated": list(range(6, 12))}}
        scale = {"from": "height" if options["camera_distance"] is None else "camera distance"}
        (cameras / "calibration.json").write_text(json.dumps({"cameras": lost, "scale": scale}))
        naming(cameras.name)
        set_lines(folder, cameras=cameras.name)
        return SimpleNamespace(record={"warnings": ["up is only guessed"]})

    def character_of(capture, **options):
        names.append("body")
        return MadeBody(body(options["height"]))

    def scan(video, **options):
        names.append("scan")
        return SimpleNamespace(rigged=SimpleNamespace(character=body(options["height"])), colours=None)

    def select(capture, within):
        names.append("selected frames")
        first = int(capture.video_frames[0, 0])
        return capture, {"frames": [first, first + 2], "reason": "they are good"}

    def track_capture(folder, out, **options):
        names.append("track")
        out.mkdir()
        motion.save(out)
        (out / "report.html").write_text("")
        return motion

    stand_ins = {
        "sync": sync, "detect": detect, "calibrate_folder": calibrate, "character_of": character_of,
        "with_selected_frames": select, "track_capture": track_capture, "scan": scan,
    }  # fmt: skip
    for name, stand_in in stand_ins.items():
        monkeypatch.setattr(_run_work if hasattr(_run_work, name) else _run_footage, name, stand_in)
    monkeypatch.setattr(_run_files, "require_runner", lambda: None)
    monkeypatch.setattr(_run_files, "get_weights", lambda *_, **__: None)
    monkeypatch.setattr(_run_footage, "refuse_views_of_different_people", lambda *asked: None)
    opened = Capture.open
    monkeypatch.setattr(Capture, "open", staticmethod(lambda path, **_: opened(path, with_cameras=False)))
    return names
