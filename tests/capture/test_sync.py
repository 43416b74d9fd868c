"""Synchronising whole captures: what is written, what is refused, and real videos."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from films import Film, make_capture, make_film, rate

import jaxmocap as jm
from jaxmocap._cli import run
from jaxmocap._results import InputError
from jaxmocap.capture import Capture, check, plan_sync, synchronise
from jaxmocap.capture._edit_config import with_offsets
from jaxmocap.capture._video import index_video
from jaxmocap.capture.synchronisation import _synchronise
from jaxmocap.capture.synchronisation._estimate import SURE, Undecided
from jaxmocap.capture.synchronisation._sound import RATE, Sound, compare_sounds, read_sound

STILL = {"moves": False, "times": rate(8, 4)}
LOUD = {**STILL, "sound": "noise"}


def content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """cam1 starts 12.3 frames after cam0, with a flash and sound; copy it before changing it."""
    both = {"flashes": (1.013,), "sound": "noise"}
    return make_capture(tmp_path_factory.mktemp("made") / "films", [Film(**both), Film(start=0.41, shake=2, **both)])


@pytest.fixture
def films(made, tmp_path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "films"))


def test_only_the_frames_that_count_are_listened_to_and_looked_at(films):
    """The flash is at frame 30 of cam0 and at frame 18 of cam1."""
    found = plan_sync(films, "flash", span=(10, 40)).found
    assert found.offsets == pytest.approx((0.0, 0.41), abs=0.1 / 30)
    with pytest.raises(InputError, match="no flash"):
        plan_sync(films, "flash", span=(40, None))
    late = plan_sync(films, "sound", span=(20, None)).found
    assert late.offsets == pytest.approx((0.0, 0.41), abs=0.001)
    with pytest.raises(InputError, match="frames 500: are to count, but video"):
        plan_sync(films, span=(500, None))


def test_all_methods_agree_and_capture_toml_is_completed(films):
    before = (films / "capture.toml").read_text().splitlines()
    found = jm.sync(films)
    assert found.offsets == pytest.approx((0.0, 0.41), abs=0.1 / 30)
    assert found.notes == ()
    (pair,) = found.pairs
    assert {method: estimate.offset for method, estimate in pair.estimates.items()} == {
        "flash": pytest.approx(0.41, abs=0.1 / 30),
        "sound": pytest.approx(0.41, abs=0.001),
        "motion": pytest.approx(0.41, abs=0.5 / 30),
    }
    after = (films / "capture.toml").read_text().splitlines()
    assert [line for line in after if not line.startswith("offset = ")] == before
    assert after[after.index('video = "cam0.mp4"   # phone 0') + 1] == "offset = 0.0"
    capture = Capture.open(films)
    assert capture.offsets == pytest.approx(found.offsets, abs=1e-6)
    np.testing.assert_array_equal(capture.video_frames[:, 0], [12, 0])
    report = json.loads((films / "sync.json").read_text())
    assert report["cameras"]["cam1"]["whole_frames"] == 12
    assert report["pairs"][0]["estimates"]["flash"]["frames"] == [[30, 18]]
    assert not any(finding.severity == "error" for finding in check(films))


@pytest.mark.parametrize("method", ["flash", "sound", "motion"])
def test_one_method_can_be_asked_alone_from_the_command_line(films, capsys, method):
    assert run(["sync", str(films), "--method", method, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["pairs"][0]["used"] == method
    assert list(answer["pairs"][0]["estimates"]) == [method]
    assert answer["cameras"]["cam1"]["offset_seconds"] == pytest.approx(0.41, abs=0.5 / 30)
    assert answer == json.loads((films / "sync.json").read_text())


def test_the_command_line_prints_a_table_and_says_what_is_doubtful(tmp_path, capsys):
    folder = make_capture(tmp_path / "films", [Film(start=2, times=rate(120, 30)), Film(start=2.7, times=rate(90, 25))])
    assert run(["sync", str(folder)]) == 0
    out, err = capsys.readouterr()
    assert "│ cam0, cam1 │ motion │" in out
    assert "cam0, cam1 by flash: cam0.mp4 and cam1.mp4 have no flash" in " ".join(out.split())
    assert "cam0 and cam1: motion alone decided, which is good to about a frame" in err


def test_offsets_of_an_earlier_run_are_replaced_and_comments_kept(films):
    file = films / "capture.toml"
    text = '# \u00e9\r\nfps = 30\r\n[[camera]] # one\r\noffset=3.5# old\r\nname="cam0"\r\nvideo="cam0.mp4"\r\n'
    text += "frames = oops\r\n\r\n[[camera]]\r\n  name = 'cam1'\r\n  video = 'cam1.mp4'  # two\r\n# end"
    file.write_bytes(text.replace("frames = oops\r\n", "").encode())
    jm.sync(file, method="sound")
    offset = file.read_bytes().decode().split("  offset = ")[1].split("\r\n")[0]
    assert float(offset) == pytest.approx(0.41, abs=0.001)
    expected = text.replace("frames = oops\r\n", "").replace("offset=3.5#", "offset=0.0#")
    expected = expected.replace("# two\r\n", f"# two\r\n  offset = {offset}\r\n")
    assert file.read_bytes().decode() == expected


def test_a_line_that_is_forgiven_when_a_capture_is_opened_is_left_alone():
    text = 'frames = ?\n[[camera]]\nname = "a"\nvideo = "a.mp4"'
    assert with_offsets(text, [0.25], Path("capture.toml")) == text + "\noffset = 0.25\n"


@pytest.mark.parametrize(
    ("text", "edited"),
    [
        (
            'camera = [{name = "a", video = "a.mp4"}, # one\n {name = "b", video = "b.mp4", offset = 7}]\n',
            'camera = [{name = "a", video = "a.mp4", offset = 0.25}, # one\n '
            '{name = "b", video = "b.mp4", offset = -1.5}]\n',
        ),
        (
            'name = """\n[[camera]]\n"""\n[[camera]]\nname = "a"\nvideo = "a.mp4"\n\n# b\n[[camera]]\n'
            'name = "b"\n\n# end',
            'name = """\n[[camera]]\n"""\n[[camera]]\nname = "a"\nvideo = "a.mp4"\noffset = 0.25\n\n# b\n[[camera]]\n'
            'name = "b"\noffset = -1.5\n\n# end',
        ),
        (
            "\ufeff[[camera]]\r\n\tname = 'a'\r\n[[camera]]\r\nname = 'b'",
            "\ufeff[[camera]]\r\n\tname = 'a'\r\n\toffset = 0.25\r\n[[camera]]\r\nname = 'b'\r\noffset = -1.5\r\n",
        ),
    ],
)
def test_any_layout_of_the_cameras_is_completed_in_place(text, edited):
    assert with_offsets(text, [0.25, -1.5], Path("capture.toml")) == edited


@pytest.mark.parametrize(
    ("text", "words"), [("[[camera]]\n", "1 cameras, and offsets were found for 2"), ("[[camera", "is not valid TOML")]
)
def test_a_file_that_was_changed_meanwhile_is_refused(text, words):
    with pytest.raises(InputError, match=rf"^capture\.toml .*{words}"):
        with_offsets(text, [0.25, -1.5], Path("capture.toml"))


def test_what_no_longer_fits_is_said(films):
    file = films / "capture.toml"
    file.write_text("frames = 75\n" + file.read_text())
    found = jm.sync(films, method="flash")
    assert len(found.notes) == 1
    assert "frames = 75, but the videos share only 63" in found.notes[0]


@pytest.mark.parametrize(
    ("first", "second", "words"),
    [
        (Film(**STILL, shake=2), Film(**STILL, shake=2), ["have no flash", "has no sound", "nothing moves in cam0"]),
        (Film(light=0.0), Film(), ["by flash, cam0.mp4 is black", "by motion, cam0.mp4 is black"]),
        (Film(), Film(**STILL), ["cam1.mp4 shows the same picture all the time"]),
        (Film(start=2), Film(start=4, times=rate(20, 30)), ["by motion, cam1.mp4 is shorter than 1 s"]),
        (Film(start=5, **LOUD), Film(start=20, **LOUD), ["nowhere better than elsewhere"]),  # 15 s apart
        (Film(), Film(times=(0.0,)), ["cam1.mp4 has one frame"]),
    ],
)
def test_videos_that_nothing_can_synchronise_are_refused_in_one_sentence(tmp_path, capsys, first, second, words):
    folder = make_capture(tmp_path / "films", [first, second])
    before = content(folder)
    assert run(["sync", str(folder)]) == 2
    out, err = capsys.readouterr()
    *stages, sentence = err.splitlines()
    assert all(stage.endswith(" ...") for stage in stages)
    assert out == ""
    assert sentence.startswith("jaxmocap: ")
    for word in words:
        assert word in sentence
    assert content(folder) == before


def test_damaged_videos_and_wrong_arguments_are_refused_by_name(films, tmp_path, capsys):
    with pytest.raises(InputError, match=r"nowhere does not exist"):
        jm.sync(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"2 paths were given; give one capture folder"):
        jm.sync([films, films])
    with pytest.raises(InputError, match=r"needs two or more videos, and 1 was given"):
        jm.sync([films / "cam0.mp4"], out=tmp_path / "new")
    with pytest.raises(InputError, match=r"exists already"):
        jm.sync([films / "cam0.mp4", films / "cam1.mp4"], out=films)
    assert run(["sync"]) == 2
    assert "0 paths were given" in capsys.readouterr().err
    file = films / "cam1.mp4"
    file.write_bytes(file.read_bytes()[:3000])
    before = content(films)
    with pytest.raises(InputError, match=r"cam1\.mp4"):
        jm.sync(films)
    assert content(films) == before


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write everywhere")
def test_a_folder_that_cannot_be_written_is_refused(films):
    films.chmod(0o555)
    try:
        with pytest.raises(InputError, match=r"cannot be written"):
            jm.sync(films, method="sound")
    finally:
        films.chmod(0o755)


def test_videos_become_a_new_capture(made, tmp_path, capsys):
    out = tmp_path / "deep" / "new"
    videos = [made / "cam0.mp4", shutil.copy(made / "cam1.mp4", tmp_path / 'left "phone".mp4')]
    assert run(["sync", *map(str, videos), "--out", str(out), "--method", "sound", "--json"]) == 0
    assert list(json.loads(capsys.readouterr().out)["cameras"]) == ["cam0", "left__phone_"]
    capture = Capture.open(out)
    assert capture.name == "new"
    assert capture.fps == pytest.approx(30, rel=1e-3)
    assert capture.camera_names == ("cam0", "left__phone_")
    assert capture.offsets == pytest.approx((0.0, 0.41), abs=0.001)
    assert (out / "cam0.mp4").read_bytes() == (made / "cam0.mp4").read_bytes()
    assert sorted(path.name for path in out.iterdir()) == ["cam0.mp4", "capture.toml", "left__phone_.mp4", "sync.json"]


def test_videos_of_one_name_get_numbers(made, tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    same = [shutil.copy(made / f"cam{i}.mp4", tmp_path / name / "IMG_1.mp4") for i, name in enumerate("ab")]
    assert jm.sync(same, out=tmp_path / "new", method="sound").cameras == ("cam0", "cam1")


def test_nothing_is_left_of_a_new_capture_that_fails(tmp_path):
    videos = [make_film(tmp_path / f"{number}.mp4", Film(**STILL)) for number in range(2)]
    with pytest.raises(InputError, match="cannot be synchronised"):
        jm.sync(videos, out=tmp_path / "new")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0.mp4", "1.mp4"]


def test_a_third_camera_may_be_tied_to_the_second(tmp_path):
    """cam2 has sound but no flash, cam0 a flash but no sound."""
    still = {"moves": False}
    films = [
        Film(flashes=(1.013,), **still),
        Film(start=0.4, flashes=(1.013,), sound="noise", **still),
        Film(start=0.9, sound="noise", **still),
    ]
    found = plan_sync(make_capture(tmp_path / "films", films)).found
    assert found.offsets == pytest.approx((0.0, 0.4, 0.9), abs=0.005)
    assert [pair.chosen and pair.chosen.method for pair in found.pairs] == ["flash", None, "sound"]


def test_in_long_videos_motion_is_asked_only_where_it_is_needed(films, monkeypatch):
    monkeypatch.setattr(_synchronise, "_FEW_FRAMES", 10)
    videos = [index_video(films / f"cam{number}.mp4") for number in range(2)]
    (pair,) = synchronise(videos, ("cam0", "cam1")).pairs
    assert set(pair.estimates) == {"flash", "sound"}
    assert pair.reasons == {"motion": "it was not asked, for flash and sound agree"}


# Real videos ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("method", "frames"),
    [("flash", 0.01), ("sound", 0.01), pytest.param("auto", 0.01, marks=pytest.mark.slow)],
)
def test_two_phones_on_a_square_are_synchronised_to_the_frame(data, tmp_path, method, frames):
    source = data / "plaza_raw"
    if not source.is_dir():
        pytest.skip(f"{source} is not there; set JAXMOCAP_DATA")
    folder = tmp_path / "plaza_raw"
    folder.mkdir()
    for name in ("capture.toml", "cam0.mp4", "cam1.mp4", "actor.glb"):
        shutil.copyfile(source / name, folder / name)
    (folder / "keypoints").mkdir()
    with np.load(source / "truth.npz") as truth:
        first, flash = truth["frame_of_first_image"], int(truth["flash_frame"])
    found = jm.sync(folder, method=method)
    assert found.offsets[1] * 30 == pytest.approx(first[1] - first[0], abs=frames)
    assert found.notes == ()
    capture = Capture.open(folder)
    np.testing.assert_array_equal(capture.video_frames[0] - capture.video_frames[1], first[1] - first[0])
    assert capture.num_frames == 96
    if method == "flash":
        (pair,) = found.pairs
        assert pair.estimates["flash"].detail["frames"] == [[flash, flash - first[1]]]


def test_pieces_of_real_sound_fit_where_they_belong_or_are_not_believed(data):
    """Somebody claps every 0.645 s: pieces that share too little may only match one clap to the next."""
    if not (data / "plaza_raw").is_dir():
        pytest.skip(f"{data / 'plaza_raw'} is not there; set JAXMOCAP_DATA")
    sounds = [read_sound(index_video(data / "plaza_raw" / f"cam{number}.mp4")) for number in range(2)]
    random, believed = np.random.default_rng(0), 0
    for _ in range(40):
        starts, length = random.integers(0, RATE, 2), int(random.uniform(1.2, 2.3) * RATE)
        pieces = [
            Sound(sound.name, sound.samples[start : start + length], 0.0)
            for sound, start in zip(sounds, starts, strict=True)
        ]
        try:
            found = compare_sounds(*pieces)
        except Undecided:
            continue
        right = abs(found.offset - 4 / 30 - (starts[1] - starts[0]) / RATE) < 0.002
        assert right or found.confidence < SURE
        believed += right and found.confidence >= SURE
    assert believed >= 28


@pytest.mark.slow
@pytest.mark.parametrize(("name", "cameras"), [("plaza", 2), ("street", 3)])
def test_motion_of_a_person_between_moving_cameras_is_good_to_about_half_a_frame(data, name, cameras):
    videos = [index_video(data / name / f"cam{number}.mp4") for number in range(cameras)]
    found = synchronise(videos, [f"cam{number}" for number in range(cameras)], "motion")
    for pair in found.pairs:
        assert pair.chosen is not None
        assert pair.chosen.offset * 30 == pytest.approx(0, abs=0.6)
