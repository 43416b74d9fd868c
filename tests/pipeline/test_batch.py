"""Many takes: each is brought to its result once, whatever becomes of the others; what is refused before that.

Stand-ins write what `track_capture` and `run` would, for takes whose tracking is tested elsewhere.
"""

import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import replace
from html import unescape
from pathlib import Path
from urllib.parse import unquote

import jax.numpy as jnp
import numpy as np
import pytest
from small_captures import make_video

from jaxmocap._cli import run as command
from jaxmocap._results import InputError
from jaxmocap.character import Pose
from jaxmocap.motion import Motion
from jaxmocap.pipeline import RunResult, _run_files, _take, _take_result, batch
from jaxmocap.pipeline._run_record import RunRecord
from jaxmocap.pipeline._take_file import read_take_file
from jaxmocap.rigging import body
from jaxmocap.synthetic import make_capture, write_capture


@pytest.fixture(scope="module")
def motion() -> Motion:
    """Four frames, all to be trusted."""
    character = body()
    poses = Pose(jnp.stack([jnp.eye(4)] * 4), jnp.zeros((4, character.skeleton.num_angles)))
    provenance = {"lost": [], "outlier_cameras": [], "doubts": [], "seconds_per_frame": 1.5}
    return Motion.from_poses(character, poses, np.arange(4), np.arange(4) / 25, provenance=provenance)


@pytest.fixture
def takes(small, tmp_path) -> list[Path]:
    return [Path(shutil.copytree(small, tmp_path / "takes" / name)) for name in ("walk", "jump & run", "odd")]


@pytest.fixture
def tracked(monkeypatch, motion) -> list[tuple[str, dict]]:
    """The takes that were tracked, and what tracking was told. Frame 2 of "odd" is doubtful; a capture with a file
    `broken` in it cannot be used, and "walk" with the seed 13 is our mistake."""
    done: list[tuple[str, dict]] = []

    def write(folder: Path, result: Motion) -> Motion:
        result.save(folder)
        (folder / "report.html").write_text("")
        return result

    def track_capture(path, out, **options):
        if (out / "motion.npz").is_file():
            return Motion.load(out)
        done.append((out.name, options))
        if (path / "broken").exists():
            raise InputError("the videos show two places.")
        if options["seed"] == 13 and out.name == "walk":
            raise RuntimeError("out of luck")
        if out.name != "odd":
            return write(out, motion)
        doubt = {"doubts": [{"first": 2, "last": 2, "why": "it is dark"}]}
        status = np.array(["ok", "ok", "doubtful", "ok"])
        return write(out, replace(motion, status=status, provenance={**motion.provenance, **doubt}))

    def run(videos, out, **options):
        done.append((out.name, options))
        out.mkdir()
        RunRecord(out).set("capture", None, None)
        folder = out / "result"
        return RunResult(write(folder, motion), out / "capture", folder, folder / "report.html", {"track": 1.0})

    monkeypatch.setattr(_take, "track_capture", track_capture)
    monkeypatch.setattr(_take, "run", run)
    monkeypatch.setattr(_run_files, "require_runner", lambda: None)
    return done


def test_a_batch_tells_of_every_take_and_keeps_what_is_finished(takes, tracked, tmp_path):
    out, said, steps = tmp_path / "out", [], []
    found = batch(takes, out, quality="draft", say=said.append, progress=lambda *step: steps.append(step))
    assert [name for name, _ in tracked] == [take.name for take in takes]
    assert [(take.way, take.trusted_frames) for take in found.takes] == [("tracked", 4), ("tracked", 4), ("tracked", 3)]
    assert [take.trusted for take in found.takes] == [True, True, False]
    assert found.headline == "3 takes: 2 trusted throughout, 1 not throughout."
    assert found.takes[2].verdict == "3 of 4 frames can be trusted."
    assert found.takes[2].findings == ("Doubtful: frame 2: it is dark.",)
    assert said[0] == "walk (tracked): All 4 frames can be trusted."
    assert steps == [("takes", done, 3) for done in range(4)]
    again = batch([*takes[1:], takes[0]], out, quality="draft")
    assert len(tracked) == 3
    assert [(take.name, take.way) for take in again.takes] == [(n, "kept") for n in ("jump & run", "odd", "walk")]


def test_the_table_and_the_page_of_a_batch_say_the_same(takes, tracked, tmp_path):
    (takes[0] / "broken").touch()
    found = batch(takes, tmp_path / "out")
    record = json.loads((tmp_path / "out" / "batch.json").read_text())
    with (tmp_path / "out" / "batch.csv").open() as file:
        rows = list(csv.DictReader(file))
    page = found.index.read_text()
    for take, one, row in zip(found.takes, record["takes"], rows, strict=True):
        assert one["verdict"] == row["verdict"] == take.verdict
        assert [one["trusted_frames"], one["frames"]] == [int(row["trusted_frames"]), int(row["frames"])]
        assert take.verdict in page
    assert rows[0]["report"] == ""
    assert record["headline"] in page
    assert "Doubtful: frame 2: it is dark." in page
    links = [unquote(unescape(link)) for link in re.findall(r'href="([^"]*)"', page)]
    assert links == ["jump & run/report.html", "odd/report.html"]
    assert all((found.index.parent / link).is_file() for link in links)


def test_a_take_that_fails_stops_no_other_and_is_tried_again(takes, tracked, tmp_path, capsys):
    (takes[1] / "broken").touch()
    arguments = ["batch", *map(str, takes), "--out", str(tmp_path / "out")]
    assert command(arguments) == 2
    assert "the videos show two places." in capsys.readouterr().err
    (takes[1] / "broken").unlink()
    assert command([*arguments, "--json"]) == 3
    record = json.loads(capsys.readouterr().out)
    assert record["headline"] == "3 takes: 2 trusted throughout, 1 not throughout."
    assert [take["way"] for take in record["takes"]] == ["kept", "tracked", "kept"]
    assert Counter(name for name, _ in tracked) == {"walk": 1, "jump & run": 2, "odd": 1}


def test_a_take_whose_truth_breaks_the_comparison_keeps_its_row(takes, tracked, tmp_path, monkeypatch):
    def broken(motion, truth):
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(_take_result, "evaluate", broken)
    motion = replace(_take.track_capture(takes[0], tmp_path / "one" / "walk", seed=0), provenance={"truth": "t.npz"})
    monkeypatch.setattr(_take, "track_capture", lambda *_, **__: motion)
    (take,) = batch(takes[:1], tmp_path / "out").takes
    assert (take.way, take.frames) == ("tracked", 4)
    assert take.notes == ("Not compared with the truth: numpy.linalg.LinAlgError: SVD did not converge",)


def test_exit_codes_tell_trust_from_our_errors(takes, tracked, tmp_path, capsys):
    assert command(["batch", str(takes[0]), "--out", str(tmp_path / "good")]) == 0
    out = tmp_path / "unlucky"
    assert command(["batch", *map(str, takes), "--out", str(out), "--seed", "13"]) == 1
    assert "walk (failed): RuntimeError: out of luck" in capsys.readouterr().err
    failed, *others = json.loads((out / "batch.json").read_text())["takes"]
    assert "in track_capture" in failed["traceback"]
    assert [take["way"] for take in others] == ["tracked", "tracked"]


def test_an_interruption_passes_and_the_page_says_what_is_still_to_do(takes, tracked, tmp_path, monkeypatch):
    plain, said = _take.track_capture, []

    def interrupted(path, out, **options):
        if out.name == "jump & run":
            raise KeyboardInterrupt
        return plain(path, out, **options)

    monkeypatch.setattr(_take, "track_capture", interrupted)
    with pytest.raises(KeyboardInterrupt):
        batch(takes, tmp_path / "out", say=said.append)
    assert said[-1].endswith("the same again goes on from there.")
    assert "1 trusted throughout, 2 still to do" in (tmp_path / "out" / "index.html").read_text()
    monkeypatch.setattr(_take, "track_capture", plain)
    assert [take.way for take in batch(takes, tmp_path / "out").takes] == ["kept", "tracked", "tracked"]


def test_the_record_keeps_the_takes_of_earlier_calls(takes, tracked, tmp_path, monkeypatch):
    """Those of another call, and those of this one until their turn; not those whose folder is gone."""
    out = tmp_path / "out"
    kept = json.loads(batch(takes[1:], out).index.with_name("batch.json").read_text())["takes"]

    def interrupted(path, out, **options):
        raise KeyboardInterrupt

    def ways():
        return {take["name"]: take["way"] for take in json.loads((out / "batch.json").read_text())["takes"]}

    with monkeypatch.context() as patch:
        patch.setattr(_take, "track_capture", interrupted)
        with pytest.raises(KeyboardInterrupt):
            batch(takes, out)
    assert json.loads((out / "batch.json").read_text())["takes"][1:] == kept
    assert ways() == {"walk": "waiting", "jump & run": "tracked", "odd": "tracked"}
    assert [take.name for take in batch(takes[:1], out).takes] == ["walk"]
    assert ways() == {"walk": "tracked", "jump & run": "tracked", "odd": "tracked"}
    assert "odd/report.html" in (out / "index.html").read_text()
    shutil.rmtree(out / "odd")
    batch(takes[:1], out)
    assert ways() == {"walk": "kept", "jump & run": "tracked"}
    for damaged in ("", "[]", '{"takes": [{"name": 3}]}', '{"takes": null}', "\x00"):
        (out / "batch.json").write_text(damaged)
        batch(takes[:1], out)
        assert ways() == {"walk": "kept"}


def refused(arguments: list, capsys) -> str:
    """The sentence with which a batch is refused."""
    assert command(["batch", *map(str, arguments)]) == 2
    sentence = capsys.readouterr().err.splitlines()
    assert len(sentence) == 1
    return sentence[0]


def test_what_cannot_work_is_refused_before_anything_is_done(takes, tracked, tmp_path, capsys):
    out, other = tmp_path / "out", tmp_path / "other" / "walk"
    shutil.copytree(takes[0], other)
    shutil.copytree(takes[0], tmp_path / "lock")
    (tmp_path / "file").touch()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "index.html").touch()
    (tmp_path / "taken" / "walk").mkdir(parents=True)
    (tmp_path / "taken" / "walk" / "letter.txt").touch()
    (tmp_path / "taken" / "batch.json").touch()
    cases = [
        (["--out", out], "no take is given"),
        ([tmp_path / "nowhere", "--out", out], "nowhere does not exist; expected a capture folder"),
        ([takes[0], tmp_path, "--out", out], "capture.toml does not exist; expected a capture folder"),
        ([takes[0], other, "--out", out], "two takes are called 'walk'"),
        ([takes[0], takes[0], "--out", out], "give every take once"),
        ([tmp_path / "lock", "--out", out], "a take is called 'lock', as a file of the batch is"),
        ([takes[0], "--out", tmp_path / "file"], "file is a file; a folder was expected"),
        ([takes[0], "--out", tmp_path / "mine"], "mine holds files that no batch wrote"),
        ([takes[0], "--out", tmp_path / "taken"], "take 'walk': The output folder"),
        ([*takes, "--out", out, "--frames", "4:13"], "take 'walk': frames 4:13 were asked for"),
        ([*takes, "--out", out, "--height", "18"], "take 'walk': height is 18 m"),
        ([*takes, "--out", out, "--actor", "him.glb"], "him.glb does not exist"),
        ([*takes, "--out", out, "--set", "serach=off"], "take 'walk': setting 'serach'"),
    ]
    for arguments, words in cases:
        assert words in refused(arguments, capsys)
    (takes[2] / "cam1.mp4").write_bytes(b"no video")
    assert "take 'odd': " in refused([*takes, "--out", out], capsys)
    assert tracked == []
    assert not out.exists()


def test_a_list_of_takes_names_captures_and_videos_with_what_is_known_of_them(takes, tracked, tmp_path):
    make_video(tmp_path / "left.mp4")
    make_video(tmp_path / "right.mp4", first=3)
    (tmp_path / "takes.toml").write_text("""
        [[take]]
        capture = "takes/walk"
        frames = [2, 6]

        [[take]]
        name = "second walk"
        capture = "takes/walk"
        frames = ":8"
        height = 1.6

        [[take]]
        name = "outside"
        videos = ["left.mp4", "right.mp4"]
        focal = { left = 60, right = 70 }
        offset = { right = -0.4 }
        person = { right = [3, 4.5] }
        static = true
    """)
    found = batch([takes[2], tmp_path / "takes.toml"], tmp_path / "out", height=1.8, quality="draft", seed=5)
    told = dict(tracked)
    assert list(told) == [take.name for take in found.takes] == ["odd", "walk", "second walk", "outside"]
    assert [told[name]["frames"] for name in told] == [None, (2, 6), (0, 8), (0, None)]
    assert [told[name]["height"] for name in told] == [1.8, 1.8, 1.6, 1.8]
    assert {options["quality"] for options in told.values()} == {"draft"}
    assert {options["seed"] for options in told.values()} == {5}
    assert told["outside"]["focal"] == {"left": 60, "right": 70}
    assert told["outside"]["offset"] == {"right": -0.4}
    assert told["outside"]["person"] == {"right": (3, 4.5)}
    assert told["outside"]["static"] is True
    assert found.takes[3].report == tmp_path / "out" / "outside" / "result" / "report.html"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[[take", "takes.toml is not valid TOML"),
        ("", "takes.toml lists no takes; expected a [[take]] section"),
        ("take = []", "the list of takes: take = [] cannot be used"),
        ("[[take]]\nname = 'walk'", "take 1: a take has either capture"),
        ("[[take]]\ncapture = 'a'\nvideos = ['b']", "take 1: a take has either capture"),
        ("[[take]]\nvideos = ['left.mp4']", "take 1: a take of videos needs a name"),
        ("[[take]]\nname = '../up'\ncapture = 'a'", "take 1: name = '../up' cannot be used"),
        ("[[take]]\ncapture = 'a'\n[[take]]\ncapture = 'b'\nhight = 2", "take 2 has the unknown key 'hight'"),
        ("[[take]]\ncapture = 'a'\nstatic = true", "take 1: static is for takes of videos"),
        ("[[take]]\ncapture = 'a\\u0000b'".replace("'", '"'), "take 1: capture is no path of a file or folder"),
        (f"[[take]]\nname = 'a'\nvideos = ['{'b' * 300}']", "take 1: videos.0 is no path of a file or folder"),
        ("[[take]]\ncapture = 'a'\nheight = 'tall'", "take 1: height = 'tall' cannot be used; expected metres"),
        (
            "[[take]]\ncapture = 'a'\n[[take]]\ncapture = 'b'\nframes = '5-9'",
            "takes.toml: take 2: frames = '5-9' cannot",
        ),
        (
            "[[take]]\nname = 'a'\nvideos = ['b']\nfocal = {left = 'long'}",
            "focal.left = 'long' cannot be used; expected pix",
        ),
        ("[[take]]\ncapture = 'a'\nactor = 2", "take 1: actor = 2 cannot be used; expected a file"),
        ("take = [1]", "take 1: take = 1 cannot be used; expected a [[take]] section"),
        ("takes = 1\n[[take]]\ncapture = 'a'", "the list of takes has the unknown key 'takes'"),
        ("[[take]]\ncapture = 'nowhere'", "nowhere does not exist; expected a capture folder"),
        ("[[take]]\nname = 'a'\nvideos = ['nowhere.mp4']", "take 'a': "),
    ],
)
def test_a_list_of_takes_that_cannot_be_used_is_a_sentence(text, words, tracked, tmp_path, capsys):
    file = tmp_path / "takes.toml"
    file.write_text(text)
    assert words in refused([file, "--out", tmp_path / "out", "--height", "1.8"], capsys)
    assert tracked == []


def test_the_frames_of_a_take_are_written_as_on_the_command_line(tmp_path):
    file = tmp_path / "takes.toml"
    spans = {"'0:12'": (0, 12), "[0, 12]": (0, 12), "' 3 : 12 '": (3, 12), "'3:'": (3, None), "':12'": (0, 12)}
    file.write_text("".join(f"[[take]]\ncapture = 'a'\nframes = {written}\n" for written in spans))
    assert [entry.frames for entry in read_take_file(file)] == list(spans.values())


@pytest.mark.parametrize(
    "written",
    ["'5'", "'12:0'", "'-1:4'", "'a:b'", f"'{'9' * 5000}:'", "7", "[7]", "[7, 7]", "[-1, 4]", "[0, true]", "[0.0, 4]"],
)
def test_frames_of_a_take_that_are_no_span_are_refused_in_a_sentence(written, tmp_path):
    file = tmp_path / "takes.toml"
    file.write_text(f"[[take]]\ncapture = 'a'\nframes = {written}")
    with pytest.raises(InputError) as refusal:
        read_take_file(file)
    found, expected = str(refusal.value).split(" cannot be used; expected ")
    assert found == f"{file}: take 1: " + f"frames = {written}".replace("true", "True")[:80]
    assert expected == 'frames A to B - 1 with 0 <= A < B, such as "10:40", "10:", ":40" or [10, 40]'


def test_single_settings_are_not_for_videos(tracked, tmp_path, capsys):
    file = tmp_path / "takes.toml"
    file.write_text("[[take]]\nname = 'a'\nvideos = ['left.mp4']")
    assert "leave --set out" in refused([file, "--out", tmp_path / "out", "--set", "clip=off"], capsys)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_batch_that_was_killed_goes_on_to_the_same_bytes(tmp_path):
    """SIGKILL while the second take is being tracked; the first is kept, the second resumed."""
    takes = [write_capture(make_capture(5, (320, 180), seed=seed), tmp_path / f"seed{seed}") for seed in range(2)]
    out = tmp_path / "out"
    arguments = [sys.executable, "-m", "jaxmocap", "batch", *map(str, takes), "--out", str(out), "--quality", "draft"]
    process = subprocess.Popen(arguments, start_new_session=True)
    while not (out / "seed1" / "checkpoint" / "state.npz").is_file():
        assert process.poll() is None, "it ended before it could be killed"
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert subprocess.run(arguments, check=False).returncode in (0, 3)
    record = json.loads((out / "batch.json").read_text())
    assert [take["way"] for take in record["takes"]] == ["kept", "resumed"]
    assert all(take["marker_error_cm"] < 4 for take in record["takes"])
    subprocess.run([*arguments[:3], "track", str(takes[1]), "--out", str(tmp_path / "whole"), *arguments[-2:]])
    assert (tmp_path / "whole" / "motion.npz").read_bytes() == (out / "seed1" / "motion.npz").read_bytes()
