"""What `run` prints: the plan with its times, warnings with what to do, and where the page is."""

import json
from types import SimpleNamespace

import pytest
from stand_ins import again

from jaxmocap._cli import run as command
from jaxmocap.pipeline import _run_footage, _run_work, run


def test_the_command_prints_plan_and_report(clips, done, tmp_path, capsys):
    out = tmp_path / "dance"
    arguments = ["run", *map(str, clips), "--height", "1.8", "--out", str(out), "--frames", "0:2", "--json"]
    assert command(arguments) in (0, 3)
    told = capsys.readouterr()
    assert json.loads(told.out)["report"] == str(out / "result" / "report.html")
    assert "4. calibrate: find the cameras, to do, about " in told.err
    assert command([*arguments[:-2], "5:2"]) == 2
    assert "frames 5:2 were asked for, but left.mp4 has 12 frames" in capsys.readouterr().err
    assert command([*arguments[:-2], "0:99"]) == 2
    assert "frames 0:99 were asked for, but left.mp4 has 12 frames" in capsys.readouterr().err


@pytest.mark.parametrize("on_a_terminal", [False, True])
def test_the_page_is_named_whole_whatever_its_path(clips, done, tmp_path, capsys, monkeypatch, on_a_terminal):
    if on_a_terminal:
        monkeypatch.setenv("FORCE_COLOR", "1")
        monkeypatch.setenv("COLUMNS", "40")
    out = tmp_path / "dance [final] [" / "b]"
    assert command(["run", *map(str, clips), "--height", "1.8", "--out", str(out)]) in (0, 3)
    assert f"Open {out / 'result' / 'report.html'}\n" in capsys.readouterr().out


def test_what_is_advised_works_as_it_is_said(clips, done, tmp_path, monkeypatch):
    stand_in, said, capture = _run_footage.calibrate_folder, [], tmp_path / "dance" / "capture"

    def calibrate(folder, say, **options):
        stand_in(folder, say, **options)
        warnings = ["if the result leans, give it with --up", "or calibrate with --key-step 2 if it is", "with --pose"]
        return SimpleNamespace(record={"warnings": warnings})

    monkeypatch.setattr(_run_footage, "calibrate_folder", calibrate)
    again(clips, tmp_path / "dance", say=said.append)
    calibrated = f"jaxmocap calibrate {capture} --replace --height 1.8"
    assert f"Warning: if the result leans, give it with {calibrated} --up X Y Z." in said
    assert f"Warning: or run {calibrated} --key-step 2 if it is." in said
    assert f"Warning: with jaxmocap track {capture} --pose FILE --out DIR." in said
    said.clear()
    again(clips, tmp_path / "dance", camera_distance=2.0, say=said.append)
    assert any("--replace --camera-distance 2 --key-step 2" in sentence for sentence in said)


def test_whoever_stops_a_run_is_told_that_it_goes_on(clips, done, tmp_path, capsys, monkeypatch):
    def stopped(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(_run_work, "track_capture", stopped)
    assert command(["run", *map(str, clips), "--height", "1.8", "--out", str(tmp_path / "dance")]) == 130
    assert "interrupted; no result was written; the same command goes on where it" in capsys.readouterr().err


def test_the_time_of_a_draft_is_not_that_of_the_paper_nor_that_of_other_frames(clips, done, tmp_path):
    seconds: list[float] = []
    for told in ({"quality": "draft"}, {"quality": "draft", "seed": 1}, {"quality": "paper"}, {"frames": (0, 3)}):
        run(clips, tmp_path / "dance", height=1.8, plan=lambda stages: seconds.append(stages[-1].seconds), **told)
    first, same, *others = seconds
    assert same < 2 < 90 < min(first, *others)
