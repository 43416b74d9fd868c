"""Selected frames chosen from keypoints: motions of which it is known what stands for them."""

import json
from pathlib import Path

import numpy as np
import pytest
from small_captures import PERSON, POSES, SIZE, TOML, make_video, write_keypoints, write_model

from jaxmocap.capture import Capture, check, choose_frames, lit_by_flash

COUNT = 30
UP, CROUCHED, TURNED = "up", "crouched", "turned"


def person(kind: str, sway: float = 0.0) -> np.ndarray:
    points = PERSON.copy()
    if kind == UP:
        points[[3, 4, 6, 7], 1] = [1.55, 1.85, 1.55, 1.85]
    if kind == CROUCHED:
        points[[10, 13], 2] += 0.4
        points[[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 12], 1] -= 0.4
    if kind == TURNED:
        points[:, [0, 2]] *= -1
    return points + [sway, 0, 0]


@pytest.fixture
def folder(tmp_path) -> Path:
    """A capture of 30 frames that names no selected frames, and no keypoints yet."""
    for name in POSES:
        make_video(tmp_path / f"{name}.mp4", COUNT, SIZE)
    write_model(tmp_path / "cameras", POSES, COUNT)
    text = TOML.replace("frames = 12", f"frames = {COUNT}").replace("selected_frames = [0, 6]\n", "")
    (tmp_path / "capture.toml").write_text(text.replace('masks = "masks"\n', ""))
    (tmp_path / "keypoints").mkdir()
    return tmp_path


def filmed(folder: Path, people: dict[int, np.ndarray], cameras=tuple(POSES)) -> Capture:
    for frame, points in people.items():
        for name in cameras:
            write_keypoints(folder / "keypoints" / f"{name}_{frame:05d}_keypoints.json", POSES[name], points=points)
    return Capture.open(folder)


def frames_of(capture: Capture, count: int = 3) -> tuple[int, ...]:
    return choose_frames(capture, capture.cameras, count).frames


def test_every_pose_is_shown_once_however_unequal_their_times(folder):
    kinds = [UP] * 18 + [CROUCHED] * 4 + ["standing"] * 8
    capture = filmed(folder, {frame: person(kind, 0.001 * frame) for frame, kind in enumerate(kinds)})
    chosen = frames_of(capture)
    assert [kinds[frame] for frame in chosen] == [UP, CROUCHED, "standing"]
    assert chosen[0] <= 1  # near the start
    assert chosen == frames_of(Capture.open(folder))


def test_the_other_side_of_the_body_counts_though_the_pose_is_the_same(folder):
    kinds = ["standing"] * 20 + [TURNED] * 10
    chosen = frames_of(filmed(folder, {frame: person(kind) for frame, kind in enumerate(kinds)}))
    assert [kinds[frame] for frame in chosen] == ["standing", TURNED]  # a third would add nothing


def test_one_odd_frame_does_not_stand_for_a_pose(folder):
    people = {frame: person("standing" if frame < 15 else CROUCHED, 0.001 * frame) for frame in range(COUNT)}
    people[9] = people[9].copy()
    people[9][[4, 7, 11, 14]] += [0.5, 0.6, 0.5]  # detections gone astray
    assert 9 not in frames_of(filmed(folder, people))


def test_frames_whose_views_contradict_each_other_or_lack_joints_are_left_out(folder):
    capture = filmed(folder, {frame: person("standing") for frame in range(3, 20)})
    write_keypoints(folder / "keypoints" / "cam1_00003_keypoints.json", POSES["cam1"], points=person(UP) + [0, 0.5, 0])
    for frame in range(20, 30):  # only one camera sees the crouch
        filmed(folder, {frame: person(CROUCHED)}, cameras=("cam0",))
    chosen = frames_of(capture)
    assert all(4 <= frame < 20 for frame in chosen)


def test_few_keypoints_are_used_as_they_are_and_none_means_the_first_frame(folder):
    empty = Capture.open(folder)
    nothing = choose_frames(empty, empty.cameras)
    assert nothing.frames == (0,)
    assert "no frame has three keypoints" in nothing.reason
    assert choose_frames(empty, empty.cameras, within=(4, 8)).frames == (4,)
    capture = filmed(folder, {5: person(UP), 25: person(CROUCHED)})
    assert frames_of(capture) == (5, 25)
    assert frames_of(capture, 1) == (5,)
    assert capture.with_selected_frames((25, 5)).selected_frames == (5, 25)


def test_a_frame_that_shows_half_a_body_is_better_than_none(folder):
    half = person("standing")
    capture = filmed(folder, {7: half})
    for name in POSES:
        file = folder / "keypoints" / f"{name}_00007_keypoints.json"
        write_keypoints(file, POSES[name], points=half)
        text = np.array(json.loads(file.read_text())["people"][0]["pose_keypoints_2d"]).reshape(25, 3)
        text[8:] = 0
        file.write_text(json.dumps({"people": [{"pose_keypoints_2d": text.ravel().tolist()}]}))
    chosen = choose_frames(capture, capture.cameras)
    assert chosen.frames == (7,)
    assert "7 of 13" in chosen.reason


def test_a_single_camera_chooses_by_what_it_sees(folder):
    text = (folder / "capture.toml").read_text()
    (folder / "capture.toml").write_text(text[: text.index('[[camera]]\nname = "cam1"')])
    kinds = [UP] * 18 + [CROUCHED] * 4 + ["standing"] * 8
    capture = filmed(folder, {frame: person(kind, 0.001 * frame) for frame, kind in enumerate(kinds)}, ("cam0",))
    chosen = choose_frames(capture, capture.cameras)
    assert [kinds[frame] for frame in chosen.frames] == [UP, CROUCHED, "standing"]
    assert "its view" in chosen.reason


def test_only_frames_that_are_wanted_are_chosen(folder):
    kinds = [UP] * 10 + [CROUCHED] * 10 + ["standing"] * 10
    capture = filmed(folder, {frame: person(kind, 0.001 * frame) for frame, kind in enumerate(kinds)})
    chosen = choose_frames(capture, capture.cameras, within=(12, None)).frames
    assert min(chosen) >= 12
    assert {kinds[frame] for frame in chosen} == {CROUCHED, "standing"}


def test_a_flash_is_never_chosen_and_one_that_is_selected_by_hand_is_named(folder):
    """The person's colours are learnt from selected frames. Black pictures are in another light, too."""
    kinds = ["standing"] * 10 + [CROUCHED] * 20
    people = {frame: person(kind, 0.001 * frame) for frame, kind in enumerate(kinds)}
    chosen = frames_of(filmed(folder, people))
    for name in POSES:
        make_video(folder / f"{name}.mp4", COUNT, SIZE, black=[*chosen, chosen[1] + 1])
    others = frames_of(Capture.open(folder))
    assert len(others) == len(chosen)
    assert not {*chosen, chosen[1] + 1} & {*others}
    capture = Capture.open(folder)
    lit = [frame for frame in range(COUNT) if lit_by_flash(capture, frame)]
    assert lit == sorted({*chosen, chosen[1] + 1})
    config = folder / "capture.toml"
    config.write_text(f"selected_frames = [{chosen[0]}, {others[1]}]\n" + config.read_text())
    said = [finding.message for finding in check(folder) if finding.where == "selected_frames"]
    assert [message for message in said if "flash" in message] == said
    assert len(said) == 1
    assert f"frame {chosen[0]} is" in said[0]
