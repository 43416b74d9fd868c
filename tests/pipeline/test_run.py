"""One command from videos to a motion: what is done, in which order, and with which cameras and body.

Stand-ins take the place of the stages.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from small_captures import make_video
from stand_ins import STAGES, again

from jaxmocap._results import InputError
from jaxmocap.capture import Capture
from jaxmocap.character import Character, stature
from jaxmocap.pipeline import _run_footage, run
from jaxmocap.rigging import body


def test_everything_is_done_once_and_then_read(clips, done, tmp_path):
    out = tmp_path / "dance"
    result, names = again(clips, out)
    assert names == STAGES
    assert list(dict.fromkeys(done)) == STAGES[1:]
    assert (result.capture, result.report) == (out / "capture", out / "result" / "report.html")
    assert len(result.motion) == 2
    text = (out / "capture" / "capture.toml").read_text()
    assert 'name = "dance"' in text
    assert 'video = "right_hand.mp4"' in text
    for line in (
        "offset = 0.0",
        'keypoints = "keypoints"',
        'cameras = "cameras"',
        'actor = "actor.glb"',
        "selected_frames = [0, 2]",
    ):
        assert line in text
    opened = Capture.open(out / "capture")
    assert opened.sizes == ((64, 48), (48, 64))
    done.clear()
    result, names = again(clips, out)
    assert (names, done) == ([], [])
    assert len(result.motion) == 2


def test_a_body_that_was_made_of_other_keypoints_does_not_tell_the_scale_of_new_cameras(
    clips, done, tmp_path, monkeypatch
):
    """Nor do the cameras of before say which new keypoints are right; what was set by hand does."""
    out, seen = tmp_path / "dance", []
    toml = out / "capture" / "capture.toml"

    def noting(module, name):
        stand_in = getattr(module, name)

        def noted(folder, *told, **options):
            text = toml.read_text()
            seen.append((name.removesuffix("_folder"), "actor =" in text, "cameras =" in text))
            return stand_in(folder, *told, **options)

        monkeypatch.setattr(module, name, noted)

    noting(_run_footage, "detect")
    noting(_run_footage, "calibrate_folder")
    first = [("detect", False, False), ("calibrate", False, False)]
    after = ("detect", False, True)  # views are held against each other with the cameras just found
    again(clips, out)
    assert seen == [*first, after]
    seen.clear()
    assert again(clips, out, person={"left": (3.0, 4.0)})[1] == STAGES[2:]
    assert seen == [*first, after]
    seen.clear()
    shutil.copy(out / "capture" / "actor.glb", out / "capture" / "mine.glb")
    toml.write_text(toml.read_text().replace("actor-2.glb", "mine.glb"))
    again(clips, out, person={"left": (5.0, 4.0)})
    assert [actor for _, actor, _ in seen] == [True, True, True]


def test_an_actor_comes_first_for_its_bones_tell_the_scale(clips, done, tmp_path):
    actor = tmp_path / "me.glb"
    body(1.7).save_glb(actor)
    _, names = again(clips, tmp_path / "dance", actor=actor, height=None)
    assert names == ["capture", "synchronise", "body", "detect", "calibrate", "selected frames", "track"]
    assert "body" not in done
    assert (tmp_path / "dance" / "capture" / "actor.glb").read_bytes() == actor.read_bytes()


@pytest.mark.slow
def test_an_actor_becomes_as_tall_as_the_height_that_is_given(clips, done, tmp_path):
    """As tall as the world of the cameras, whose scale the height tells too."""
    out, actor, bare = tmp_path / "dance", tmp_path / "me.glb", tmp_path / "me.obj"
    body(1.7).save_glb(actor)
    said: list[str] = []
    again(clips, out, actor=actor, height=1.8, say=said.append)
    assert float(stature(Character.load(out / "capture" / "actor.glb"))) == pytest.approx(1.8, abs=1e-3)
    assert any("me.glb is 1.70 m tall, and was scaled to the 1.80 m" in sentence for sentence in said)
    run(clips, out, actor=actor, height=1.705)
    assert (out / "capture" / "actor-2.glb").read_bytes() == actor.read_bytes()
    character = body(1.8)
    trimesh.Trimesh(3.0 * np.asarray(character.vertices), np.asarray(character.faces)).export(bare)  # no metres
    run(clips, out, actor=bare, height=1.8)
    assert float(stature(Character.load(out / "capture" / "actor-3.glb"))) == pytest.approx(1.8, abs=0.01)


def test_a_walk_around_the_person_becomes_the_actor_and_is_made_again_when_it_changes(clips, done, tmp_path):
    walk = make_video(tmp_path / "walk.mp4")
    _, names = again(clips, tmp_path / "dance", scan=walk)
    assert names == ["capture", "synchronise", "body", "detect", "calibrate", "selected frames", "track"]
    assert "scan" in done
    assert "body" not in done
    assert again(clips, tmp_path / "dance", scan=walk)[1] == []
    make_video(walk, size=(48, 64))
    assert list(run(clips, tmp_path / "dance", height=1.8, scan=walk).seconds)[:2] == ["body", "calibrate"]


def test_without_a_height_the_scan_is_as_tall_as_the_person_between_cameras_of_known_distance(clips, done, tmp_path):
    """The built-in body is made to the person's measure first, of cameras that are there by then."""
    walk, out, said = make_video(tmp_path / "walk.mp4"), tmp_path / "dance", []
    told = {"scan": walk, "height": None, "camera_distance": 2.0}
    assert again(clips, out, **told, say=said.append)[1] == STAGES
    assert [name for name in done if name in ("calibrate", "body", "scan")] == ["calibrate", "body", "scan"]
    tall = float(stature(body()))
    assert float(stature(Character.load(out / "capture" / "actor.glb"))) == pytest.approx(tall, abs=1e-3)
    assert f"The scan is made {tall:.2f} m tall, as the person is by the distance between the cameras." in said
    assert again(clips, out, **told)[1] == []
    behind = ["selected frames", "track"]
    assert again(clips, out, **(told | {"camera_distance": 2.1}))[1] == ["calibrate", "body", *behind]
    assert list(run(clips, out, **(told | {"height": 1.8})).seconds) == ["body", "calibrate", *behind]
    assert float(stature(Character.load(out / "capture" / "actor-3.glb"))) == pytest.approx(1.8, abs=1e-3)
    assert again(clips, out, **told)[1] == ["calibrate", "body", *behind]
    with pytest.raises(InputError, match="--scan does not tell how large the person is"):
        run(clips[0], tmp_path / "one", scan=walk)


def test_views_that_a_scan_kept_have_a_size_of_their_own(clips, done, tmp_path):
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "views.json").write_text("{}")
    _, names = again(clips, tmp_path / "dance", scan=tmp_path / "kept", height=None)
    assert names == ["capture", "synchronise", "body", "detect", "calibrate", "selected frames", "track"]
    assert "scan" in done
    assert "body" not in done


def test_a_camera_is_called_as_in_the_capture_or_like_its_video_now(clips, done, tmp_path):
    out, moved = tmp_path / "dance", [clips[0], Path(shutil.copy(clips[1], tmp_path / "b.mp4"))]
    again(clips, out)
    again(moved, out, person={"b": (3.0, 4.0)})
    assert json.loads((out / "capture" / "keypoints" / "left.json").read_text()) == [["right_hand", [3.0, 4.0]]]
    assert again(moved, out, person={"right_hand": (3.0, 4.0)})[1] == []
    with pytest.raises(InputError, match=r"--focal names 'me'; .*: left, right_hand"):
        again(moved, out, focal={"me": 900.0})


def test_portrait_beside_landscape_keeps_its_shape(clips, done, tmp_path):
    again(clips, tmp_path / "dance")
    assert Capture.open(tmp_path / "dance" / "capture").recorded_sizes == ((64, 48), (48, 64))


@pytest.mark.parametrize(("said", "expected"), [({}, "None"), ({"static": True}, "True")])
def test_the_videos_tell_whether_cameras_stand_still_unless_it_is_said(clips, tmp_path, done, said, expected):
    out = tmp_path / "dance"
    run(clips, out, height=1.8, **said)
    assert (out / "capture" / "cameras" / "static").read_text() == expected
