"""Tables, curves, the page and the gate, from rows that are made up."""

import json
import re
from argparse import ArgumentParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from box_figure import box_character, box_motion

from jaxmocap._results import InputError
from jaxmocap.experiments import (
    Run,
    complaints,
    error_curves,
    figures_of,
    tables_of,
    worse,
    write_figures,
    write_frames,
    write_report,
)
from jaxmocap.experiments._perform import _errors, _record
from jaxmocap.metrics import evaluate


def row(experiment, value, capture, seed, error, factor="method", method=None, status="done"):
    method = method or (value if experiment == "comparison" else "ours")
    key = f"{capture}-{method}-{value}-{seed}"
    return {
        "experiment": experiment, "factor": factor, "value": value, "capture": capture, "seed": seed, "status": status,
        "method": method, "key": key, "marker_error_cm": error, "marker_error_max_cm": error and 2 * error,
        "seconds_per_frame": 1.5, "seconds": 10.0, "cpu_seconds": 15.0, "device": "a <machine>", "capture_hash": "cafe",
        "versions": {"jaxmocap": "1"}, "error_per_frame_cm": error and [error, error + 1], "frame_numbers": [0, 1],
        "error": None if status == "done" else "it <broke>",
    }  # fmt: skip


@pytest.fixture
def rows():
    found = []
    for capture, offset in (("square", 0.0), ("street", 1.0)):
        for seed in (0, 1, 2):
            found.append(row("comparison", "ours", capture, seed, 2.0 + offset + 0.1 * seed))
            found.append(row("comparison", "posecut", capture, seed, 5.0 + offset + 0.2 * seed))
    found.append(row("comparison", "keypoints", "square", 0, None, status="failed"))
    found += [row("lambda", value, "square", 0, error, "lambda") for value, error in (("0", 4.0), ("0.3", 2.5))]
    return found


def test_the_tables_hold_medians_quartiles_and_paired_differences(rows):
    errors, margins, sweep = tables_of(rows)
    assert errors.head == ("method", "square", "street", "all", "s per frame")
    assert errors.body[0] == ("ours", "2.10 [2.05, 2.15]", "3.10 [3.05, 3.15]", "2.60 [2.12, 3.08]", "1.5")
    assert errors.body[2][1] == "failed"
    assert margins.body[0] == ("posecut", "2", "+3.10", "", "not sure")
    assert margins.body[1][0] == "keypoints"
    assert margins.body[1][-1] == "no pairs"
    assert sweep.body == [("square", "0", "4.00", "8.00", "", ""), ("square", "0.3", "2.50", "5.00", "-1.50", "")]


def test_methods_are_compared_solved_as_a_clip_too(rows):
    for one in rows:
        if one["status"] == "done" and one["experiment"] == "comparison":
            one |= {"marker_error_by_frame_cm": one["marker_error_cm"]}
            one |= {"marker_error_solved_cm": one["marker_error_cm"] - (0.5 if one["value"] == "ours" else 1.5)}
    alike = tables_of(rows)[2]
    assert alike.head[1:3] == ("frame by frame", "solved")
    assert alike.body == [
        ("ours", "2.60", "2.10", "", "", ""),
        ("posecut", "5.70", "4.20", "+2.10", "", "not sure"),
    ]


def test_six_captures_tell_methods_apart_that_differ_in_each():
    errors = {"ours": (2, 3, 1, 2, 4, 2), "posecut": (4, 6, 5, 7, 9, 8), "hasler-1": (1, 4, 2, 1, 5, 1)}
    rows = [row("comparison", name, str(n), 0, float(e)) for name, of in errors.items() for n, e in enumerate(of)]
    assert tables_of(rows)[1].body == [
        ("posecut", "6", "+4.50", "[+2.50, +5.50]", "ours is better"),
        ("hasler-1", "6", "+0.00", "[-1.00, +1.00]", "not sure"),
    ]


def test_a_truth_of_joints_alone_is_reported_by_joints(rows, tmp_path):
    for one in rows:
        error, worst = one.pop("marker_error_cm"), one.pop("marker_error_max_cm")
        one |= {"joint_error_cm": error, "joint_error_p95_cm": worst, "error_per_frame_cm": None}
    errors, margins, sweep = tables_of(rows)
    assert errors.caption.startswith("Joint error in cm")
    assert errors.body[0] == ("ours", "2.10 [2.05, 2.15]", "3.10 [3.05, 3.15]", "2.60 [2.12, 3.08]", "1.5")
    assert errors.body[2][1] == "failed"
    assert errors.body[2][2] == "–"  # which was not run
    assert margins.body[0] == ("posecut", "2", "+3.10", "", "not sure")
    assert "joint error" in margins.caption
    assert sweep.head == ("capture", "lambda", "joint error cm", "95th percentile cm", "change", "")
    assert sweep.body[1] == ("square", "0.3", "2.50", "5.00", "-1.50", "")
    assert "comparison, square, ours: joint error" in {one["metric"] for one in figures_of(rows)}
    assert "Marker error" not in write_report(rows, tmp_path, {})[0].read_text()


def test_a_run_that_finished_without_an_error_to_show_did_not_fail(rows):
    rows += [row("comparison", "ours", "no markers", 0, None)]
    errors = tables_of(rows)[0]
    assert (errors.head[3], errors.body[0][3]) == ("no markers", "–")


def test_the_curve_of_a_constant_error_is_a_level_line():
    picture = ElementTree.fromstring(error_curves({"ours": ([3, 4, 5], [2.0, 2.0, 2.0]), "b": ([3, 5], [0.0, 4.0])}))
    lines = [e.get("points") for e in picture.iter() if e.tag.endswith("polyline")]
    first, second = ([tuple(map(float, p.split(","))) for p in line.split()] for line in lines)
    assert len({y for _, y in first}) == 1
    assert [x for x, _ in first] == sorted(x for x, _ in first)
    assert second[0][1] > first[0][1] > second[1][1]  # 0, 2 and 4 cm, upwards
    assert (second[0][1] - first[0][1]) == pytest.approx(first[0][1] - second[1][1], abs=0.11)


def test_a_method_that_lost_the_person_does_not_flatten_the_curves_of_others(rows, tmp_path):
    per_frame = {"ours": [1.0, 2.0], "posecut": [3.0, 4.0], "lost": [5.0, 400.0]}
    rows = [row("comparison", name, "square", 0, 1.0) | {"error_per_frame_cm": of} for name, of in per_frame.items()]
    page = write_report([one | {"frame_numbers": [0, 1]} for one in rows], tmp_path, {})[0].read_text()
    heights = [float(line.split()[-1].split(",")[1]) for line in re.findall(r'points="([^"]*)"', page)]
    assert heights[0] - heights[1] > 20  # pixels between 2 and 4 cm
    assert heights[2] == 10.0  # the axis's end


def test_the_comparison_has_all_its_tables_before_the_parts(rows, tmp_path):
    for one in rows:
        if one["status"] == "done" and one["experiment"] == "comparison":
            one |= {f"marker_error_{of}_cm": one["marker_error_cm"] for of in ("by_frame", "solved")}
    page = write_report(rows, tmp_path, {})[0].read_text()
    assert page.index("solved as a clip") < page.index("One part or setting at a time")


def test_unknown_errors_are_left_out_of_a_curve():
    picture = error_curves({"ours": ([0, 1, 2], [1.0, float("nan"), 3.0])})
    assert len(re.search(r'points="([^"]*)"', picture)[1].split()) == 2
    assert "nan" not in picture


def test_frames_that_the_truth_does_not_cover_have_no_error_in_the_report(tmp_path):
    motion = box_motion(box_character(), num_frames=6)
    markers = np.stack([motion.vertices(frame)[:5] for frame in range(6)]).astype(float)
    np.savez(tmp_path / "truth.npz", markers=markers[2:5], timestamps=motion.timestamps[2:5])
    record = _record(Run("square"), "cafe", motion, [], 1.0, 1.0, 1.0)
    record |= _errors(evaluate(motion, tmp_path / "truth.npz"))
    rows = [{"experiment": "comparison", "factor": "method", "value": "ours", **record}]
    lines = write_frames(rows, tmp_path / "frames.csv").read_text().splitlines()[1:]
    assert [line.split(",")[4] for line in lines] == ["2", "3", "4"]
    assert write_report(rows, tmp_path, {})[0].read_text().count("<polyline") == 1


def test_the_page_needs_nothing_else_and_escapes_what_it_is_told(rows, tmp_path):
    html, markdown = write_report(rows, tmp_path, {}, "A < B", ["note"])
    page = html.read_text()

    links = re.findall(r'(?:src|href|url)[=(]["\']?([^"\' >)]+)', page)
    assert [link for link in links if not link.startswith("data:")] == []
    assert "A &lt; B" in page
    assert "it &lt;broke&gt;" in page
    assert page.count("<svg") == 2
    text = markdown.read_text()
    assert "| posecut | 2 | +3.10 |  | not sure |" in text
    assert "square-keypoints-keypoints-0: it <broke>" in text


def test_a_planted_regression_is_found(rows, tmp_path):
    baseline = tmp_path / "figures.json"
    write_figures(figures_of(rows), baseline)
    assert complaints(figures_of(rows), baseline) == []
    for one in rows:
        if one["method"] == "ours" and one["capture"] == "street":
            one["marker_error_cm"] += 1.0
    found = complaints(figures_of(rows), baseline)
    assert len(found) == 2
    assert found[0].startswith("comparison, street, ours: marker error: 4.1 cm, was 3.1")
    assert found[1].startswith("comparison, mean of 2 captures, ours: marker error: 3.1 cm, was 2.6")


def one_seed(errors):
    return [row("comparison", "ours", f"capture {n}", 0, float(error)) for n, error in enumerate(errors)]


def test_chance_of_single_runs_passes_the_gate_and_what_all_of_them_lose_does_not(tmp_path):
    """With one seed a run may be 0.8 cm off by chance, six of them not all 0.8 cm to one side."""
    before, baseline = np.array([2.8, 2.0, 2.8, 1.8, 2.5, 3.2]), tmp_path / "figures.json"
    write_figures(figures_of(one_seed(before)), baseline)
    assert complaints(figures_of(one_seed(before + [0.8, -0.8, 0.8, -0.8, 0.8, -0.8])), baseline) == []
    (found,) = complaints(figures_of(one_seed(before + 0.8)), baseline)
    assert found.startswith("comparison, mean of 6 captures, ours: marker error")
    assert len(complaints(figures_of(one_seed(before + [2.0, 0, 0, 0, 0, 0])), baseline)) == 1


def test_seeds_that_agree_make_the_gate_narrow(tmp_path):
    """A third of a centimetre is much where three seeds differ by a hundredth."""
    baseline = tmp_path / "figures.json"
    three = [row("comparison", "ours", "square", seed, 2.0 + 0.01 * seed) for seed in range(3)]
    write_figures(figures_of(three), baseline)
    worse_by = [one | {"marker_error_cm": one["marker_error_cm"] + 0.33} for one in three]
    assert len(complaints(figures_of(worse_by), baseline)) == 1


def test_a_baseline_of_many_seeds_knows_what_chance_does_to_each_capture(tmp_path):
    """One capture moves by a centimetre from seed to seed, the other hardly: a single run is held against either."""
    baseline = tmp_path / "figures.json"
    apart = {"hard": (2.0, 3.0, 4.0, 4.5, 3.5, 2.5), "easy": (2.0, 2.1, 2.0, 1.9, 2.0, 2.0)}
    six = [row("comparison", "ours", name, n, cm) for name, errors in apart.items() for n, cm in enumerate(errors)]
    write_figures(figures_of(six), baseline)

    def one_run(hard, easy):
        rows = [row("comparison", "ours", "hard", 7, hard), row("comparison", "ours", "easy", 7, easy)]
        return [text.split(":")[0] for text in complaints(figures_of(rows), baseline)]

    assert one_run(5.0, 2.1) == []
    assert one_run(3.2, 3.0) == ["comparison, easy, ours"]
    assert "comparison, hard, ours" in one_run(7.0, 2.0)


def test_another_failure_and_a_figure_that_is_missing_are_regressions(rows, tmp_path):
    baseline = tmp_path / "figures.json"
    write_figures(figures_of(rows), baseline)
    broken = [*rows, row("lambda", "1", "square", 0, None, "lambda", status="failed")]
    assert complaints(figures_of(broken), baseline) == ["failed runs: 2.0 runs, was 1.0"]
    fewer = [one for one in rows if one["experiment"] == "comparison"]
    assert [text for text in complaints(figures_of(fewer), baseline) if "not measured" in text]


def test_baselines_that_do_not_fit_are_refused(rows, tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        complaints(figures_of(rows), tmp_path / "none.json")
    (tmp_path / "other.json").write_text(json.dumps({"figures": [{"metric": "x", "value": 1.0}]}))
    with pytest.raises(InputError, match="other experiments"):
        complaints(figures_of(rows), tmp_path / "other.json")


def test_a_benchmark_passes_its_gate_only_where_everything_was_compared(tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    from figures import add_options, finish, record

    def measured(figures, *words, **about):
        parser = ArgumentParser()
        add_options(parser)
        code = finish(figures, parser.parse_args(list(map(str, words))), **about)
        return code, capsys.readouterr().err

    kept, two = tmp_path / "new" / "kept.json", [record("time", 2.0, "s", 0.1), record("error", 3.0, "cm", 0.1)]
    assert measured(two, "--out", kept, capture="plaza", device="a") == (0, "")
    assert measured(two, "--gate", kept, capture="plaza", device="b") == (0, "")
    assert measured(two[:1], "--gate", kept) == (1, "error: not measured this time\n")
    for figures, capture, words in (
        (two, "street", "has capture plaza, this run street"),
        ([record("another", 1.0, "s", 0.1)], "plaza", "no figure in common"),
    ):
        code, said = measured(figures, "--gate", kept, "--out", tmp_path / "lost.json", capture=capture)
        assert code == 1
        assert words in said
        assert (tmp_path / "lost.json").is_file()
    assert measured([record("time", 4.0, "s", 0.1), two[1]], "--gate", kept, "--out", kept)[0] == 1
    (tmp_path / "broken.json").write_text(json.dumps({"figures": [two[0] | {"value": None}]}))
    for name in ("none.json", "broken.json"):
        with pytest.raises(SystemExit):
            measured(two, "--gate", tmp_path / name)
        assert "cannot be read" in capsys.readouterr().err


def test_worse_goes_by_direction():
    figures = [{"metric": "speed", "value": 5.0, "unit": "1/s", "direction": "higher", "tolerance": 0.1}]
    assert worse(figures, [{"metric": "speed", "value": 5.4}]) == []
    assert len(worse(figures, [{"metric": "speed", "value": 6.0}])) == 1
    assert len(worse([figures[0] | {"value": float("nan")}], [{"metric": "speed", "value": 1.0}])) == 1
