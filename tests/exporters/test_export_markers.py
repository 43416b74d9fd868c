"""C3D, TRC, MOT, CSV, Parquet and COLMAP exports, read back by others or as plain tables."""

import csv
import struct
import subprocess
import sys
from dataclasses import replace

import ezc3d
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap._results import InputError
from jaxmocap.camera import read_cameras
from jaxmocap.exporters import _c3d, export
from jaxmocap.motion import Motion
from jaxmocap.synthetic import dance, make_actor


def in_contact(motion: Motion) -> Motion:
    """Let the left foot stand in frames 9 to 13 of 7 to 18, the right one until 9 and from 16 on."""
    spans = {"l_heel": (9, 11), "l_toe": (10, 13), "r_toe": (7, 9), "r_heel": (16, 18)}
    contacts = [{"landmark": name, "first": first, "last": last} for name, (first, last) in spans.items()]
    return replace(motion, provenance={**motion.provenance, "contacts": contacts})


def residuals_of(path) -> np.ndarray:
    """Residuals as the format defines them, by frame and joint: the low byte of each point's fourth number; -1 if that
    is negative. ezc3d 1.7 looks for them in the high byte."""
    point = ezc3d.c3d(str(path))["parameters"]["POINT"]
    content, shape = path.read_bytes(), (*point["FRAMES"]["value"], *point["USED"]["value"], 4)
    (block,) = struct.unpack_from("<H", content, 16)
    words = np.frombuffer(content, "<f4", int(np.prod(shape)), 512 * (block - 1)).reshape(shape)[..., 3].astype(int)
    return np.where(words < 0, -1.0, (words & 0xFF) * -point["SCALE"]["value"][0])


def test_c3d_holds_the_joints_in_millimetres_and_residuals_that_say_how_sure(even, tmp_path):
    status = np.array(["ok"] * 11 + ["lost"])
    path = export(replace(even, status=status), tmp_path / "dance.c3d")
    file = ezc3d.c3d(str(path))
    point = file["parameters"]["POINT"]
    assert point["UNITS"]["value"] == ["mm"]
    assert (point["X_SCREEN"]["value"], point["Y_SCREEN"]["value"]) == (["+X"], ["+Y"])
    assert point["RATE"]["value"][0] == pytest.approx(30, rel=1e-6)
    assert tuple(point["LABELS"]["value"]) == even.joint_names
    found = file["data"]["points"][:3].transpose(2, 1, 0) / 1000
    np.testing.assert_allclose(found[:11], even.joints[:11], atol=1e-5)
    assert np.isnan(found[11]).all()
    residuals = residuals_of(path)
    np.testing.assert_allclose(residuals[:11], 100 * (1 - even.confidence[:11]), atol=0.5)
    assert (residuals[11] == -1).all()


def test_c3d_residuals_are_the_uncertainty_where_it_is_known(even, tmp_path):
    """Along one axis, to a millimetre; what does not fit into C3D's steps is the largest it can say."""
    deviations = np.linspace(0.01, 0.06, len(even))[:, None] * np.ones(len(even.joint_names))
    deviations[0, 0] = 3.0
    covariance = deviations[..., None, None] ** 2 * np.diag([0.5, 1.0, 1.5])
    path = export(replace(even, covariance=covariance), tmp_path / "dance.c3d")
    residuals = residuals_of(path)
    np.testing.assert_allclose(residuals[1:], 1000 * deviations[1:], atol=1.01)
    assert residuals[0, 0] == pytest.approx(510, abs=1)
    assert "standard deviation" in ezc3d.c3d(str(path))["parameters"]["JAXMOCAP"]["RESIDUALS"]["value"][0]


def events_of(path) -> list[tuple[float, str, str]]:
    """Seconds, context and label of the events that ezc3d reads."""
    group = ezc3d.c3d(str(path))["parameters"]["EVENT"]
    minutes, seconds = group["TIMES"]["value"]
    times = np.round(60 * minutes + seconds, 4).tolist()
    assert group["USED"]["value"] == [len(times)]
    return list(zip(times, group["CONTEXTS"]["value"], group["LABELS"]["value"], strict=True))


def test_c3d_has_a_strike_and_an_off_of_every_foot_that_stands(even, tmp_path):
    """A foot stands while its heel or toe does; what began before the motion, or ends after it, is no event."""
    standing = in_contact(even)
    assert events_of(export(standing, tmp_path / "dance.c3d")) == [
        (round(2 / 30, 4), "Left", "Foot Strike"),
        (round(2 / 30, 4), "Right", "Foot Off"),
        (round(6 / 30, 4), "Left", "Foot Off"),
        (round(9 / 30, 4), "Right", "Foot Strike"),
    ]
    finer = events_of(export(standing[3:], tmp_path / "part.c3d", frame_rate=60))
    assert finer == [(0.1, "Left", "Foot Off"), (0.2, "Right", "Foot Strike")]


def test_c3d_claims_nothing_of_contacts_that_were_not_looked_for(even, tmp_path):
    assert "EVENT" not in ezc3d.c3d(str(export(even, tmp_path / "not_looked_for.c3d")))["parameters"]
    none = replace(even, provenance={**even.provenance, "contacts": []})
    used = ezc3d.c3d(str(export(none, tmp_path / "none.c3d")))["parameters"]["EVENT"]["USED"]
    some = ezc3d.c3d(str(export(in_contact(even), tmp_path / "some.c3d")))["parameters"]["EVENT"]["USED"]
    assert (used["type"], used["value"]) == (some["type"], [0])


def test_c3d_holds_as_many_events_as_it_can_and_says_so(even, tmp_path):
    """Minutes are counted, and the 256th event, which the format has no room for, is left out."""
    frames = np.arange(800)
    poses = jax.tree.map(lambda leaf: jnp.repeat(leaf[:1], len(frames), axis=0), even.poses)
    spans = [{"landmark": "l_toe", "first": first, "last": first + 2} for first in range(5, 5 + 6 * 128, 6)]
    hops = Motion.from_poses(even.character, poses, frames, frames / 10, provenance={"contacts": spans})
    said = []
    found = events_of(export(hops, tmp_path / "hops.c3d", say=said.append))
    assert len(found) == 255
    assert found[-1] == (round(spans[-1]["first"] / 10, 4), "Left", "Foot Strike")
    assert found[-1][0] > 60
    assert f"255 foot events; those after {found[-1][0]:.2f} s" in said[0]


@pytest.mark.parametrize(("units", "per_metre"), [("mm", 1000), ("m", 1)])
@pytest.mark.parametrize("known", [False, True])
def test_c3d_has_one_scale_and_the_same_markers_for_every_reader(even, tmp_path, units, per_metre, known):
    """The scale stands in the header and in POINT:SCALE; py-c3d refuses files in which they differ."""
    status = np.array(["ok"] * 11 + ["lost"])
    covariance = np.zeros((*even.joints.shape, 3)) + 0.16 * np.eye(3) if known else None
    path = export(replace(even, status=status, covariance=covariance), tmp_path / "dance.c3d", units=units)
    file, content = ezc3d.c3d(str(path)), path.read_bytes()
    (scale,) = file["parameters"]["POINT"]["SCALE"]["value"]
    assert struct.unpack_from("<f", content, 12) == (np.float32(scale),)
    assert scale == pytest.approx(-per_metre * (0.002 if known else 0.0005))
    expected = per_metre * even.joints[:11]
    places = file["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_allclose(places[:11], expected, atol=1e-5 * per_metre)
    c3d = pytest.importorskip("c3d", reason="py-c3d is not installed")
    with path.open("rb") as handle:
        with pytest.warns(UserWarning, match="No analog data"):
            reader = c3d.Reader(handle)
        theirs = np.stack([points for _, points, _ in reader.read_frames()])
    assert [label.strip() for label in reader.point_labels] == list(even.joint_names)
    assert reader.get("POINT.UNITS").string_value.strip() == units
    np.testing.assert_allclose(theirs[:11, :, :3], expected, atol=1e-5 * per_metre)
    np.testing.assert_allclose(theirs[..., 3], residuals_of(path), rtol=1e-5)
    assert (theirs[11, :, 3] == -1).all()
    assert (theirs[:11, :, 4] == 0).all()  # no camera is claimed to have seen a virtual marker


def test_c3d_says_which_way_is_up(even, tmp_path):
    file = ezc3d.c3d(str(export(even, tmp_path / "dance.c3d", up="z", units="m")))
    assert file["parameters"]["POINT"]["Y_SCREEN"]["value"] == ["+Z"]
    found = file["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_allclose(found, even.joints[..., [0, 2, 1]] * [1, -1, 1], atol=1e-5)


def test_c3d_takes_a_suffix_of_capitals_and_no_more_frames_than_it_can_count(even, tmp_path, monkeypatch):
    file = ezc3d.c3d(str(export(even, tmp_path / "dance.C3D")))
    assert file["data"]["points"].shape[2] == len(even)
    monkeypatch.setattr(_c3d, "_MOST_FRAMES", len(even) - 1)
    with pytest.raises(InputError, match=f"the motion has {len(even)}; export parts"):
        export(even, tmp_path / "long.c3d")
    assert [path.name for path in tmp_path.iterdir()] == ["dance.C3D"]


def test_a_gap_changes_no_frame_rate_and_its_own_rate_changes_no_frame(even, tmp_path):
    said, gap = [], even[np.r_[0:3, 5 : len(even)]]
    export(gap, tmp_path / "gap.bvh", say=said.append)
    assert "interpolated to 30.00 frames per second" in said[0]
    frames = [row["frame"] for row in csv.DictReader(export(even[2:], tmp_path / "a.csv", frame_rate=30.0).open())]
    assert frames == [str(frame) for frame in even.frames[2:]]


def test_trc_is_a_table_of_virtual_markers(even, tmp_path):
    lines = export(even, tmp_path / "dance.trc").read_text().split("\n")
    cells = [line.split("\t") for line in lines]
    assert cells[0] == ["PathFileType", "4", "(X/Y/Z)", "dance.trc"]
    stated = dict(zip(cells[1], cells[2], strict=True))
    assert (stated["Units"], stated["DataRate"], stated["NumFrames"]) == ("mm", "30", "12")
    markers = [cell for cell in cells[3][2:] if cell]
    assert int(stated["NumMarkers"]) == len(markers)
    assert markers[:2] == ["Pelvis", "Spine"]
    assert {"LShoulder", "RHip", "MidHip", "LBigToe", "RASI", "LKNE", "C7"} <= set(markers)
    assert cells[4][2:5] == ["X1", "Y1", "Z1"]
    assert cells[5] == [""]
    table = np.array(cells[6:18], float)
    np.testing.assert_allclose(table[:, 1], even.timestamps, atol=1e-6)
    places = table[:, 2:].reshape(12, -1, 3) / 1000
    np.testing.assert_allclose(places[:, : len(even.joint_names)], even.joints, atol=1e-5)
    assert lines[18:] == [""]


def test_mot_has_the_pelvis_in_opensim_s_coordinates_and_the_joints_in_degrees(motion, tmp_path):
    head, body = export(motion, tmp_path / "dance.mot").read_text().split("endheader\n")
    assert "inDegrees=yes" in head
    assert f"nRows={len(motion)}" in head
    names, *rows = [line.split("\t") for line in body.splitlines()]
    table = dict(zip(names, np.array(rows, float).T, strict=True))
    assert f"nColumns={len(names)}" in head
    np.testing.assert_allclose(table["time"], motion.timestamps, atol=1e-6)
    pelvis = np.stack([table[f"pelvis_t{axis}"] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(pelvis, motion.joints[:, 0], atol=1e-5)
    for frame in range(len(motion)):
        tilt, list_, turn = (np.radians(table[f"pelvis_{name}"][frame]) for name in ("tilt", "list", "rotation"))
        about_z = [[np.cos(tilt), -np.sin(tilt), 0], [np.sin(tilt), np.cos(tilt), 0], [0, 0, 1]]
        about_x = [[1, 0, 0], [0, np.cos(list_), -np.sin(list_)], [0, np.sin(list_), np.cos(list_)]]
        about_y = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
        forward_up_right = np.array(about_z) @ about_x @ about_y
        root = motion.root[frame, :3, :3]
        np.testing.assert_allclose(forward_up_right, np.stack([root[:, 2], root[:, 1], -root[:, 0]], 1), atol=1e-5)


def test_elbows_and_knees_are_the_angles_between_the_bones_whatever_the_mesh_rests_in(tmp_path):
    """An actor who rests in an A-pose with bent elbows."""
    character = make_actor()
    motion = Motion.from_poses(character, dance(character.skeleton, np.arange(4) / 10), np.arange(4), np.arange(4) / 10)
    with export(motion, tmp_path / "a.csv").open() as file:
        rows = list(csv.DictReader(file))
    for frame, row in enumerate(rows):
        at = dict(zip(motion.joint_names, motion.joints[frame].astype(float), strict=True))
        for name, (a, b, c) in {
            "l_elbow_flex_deg": ("l_shoulder", "l_elbow", "l_wrist"),
            "r_knee_flex_deg": ("r_hip", "r_knee", "r_ankle"),
        }.items():
            upper, lower = at[b] - at[a], at[c] - at[b]
            cosine = upper @ lower / np.linalg.norm(upper) / np.linalg.norm(lower)
            assert float(row[name]) == pytest.approx(np.degrees(np.arccos(cosine)), abs=1.0)


def test_csv_rows_are_frames_with_units_in_the_names(motion, tmp_path):
    with export(motion, tmp_path / "dance.csv", units="cm").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["frame"]) for row in rows] == motion.frames.tolist()
    np.testing.assert_allclose([float(row["seconds"]) for row in rows], motion.timestamps, atol=1e-6)
    elbow = motion.joint_names.index("l_elbow")
    places = [[float(row[f"l_elbow_{axis}_cm"]) for axis in "xyz"] for row in rows]
    np.testing.assert_allclose(places, 100 * motion.joints[:, elbow], atol=1e-4)
    np.testing.assert_allclose([float(r["l_elbow_confidence"]) for r in rows], motion.confidence[:, elbow], atol=1e-6)
    turned = replace(motion, root=np.diag([-1.0, 1, -1, 1]) @ motion.root, joints=motion.joints * [-1, 1, -1])
    with export(turned, tmp_path / "back.csv").open() as file:
        back = list(csv.DictReader(file))
    for one, other in zip(rows, back, strict=True):
        assert abs(float(one["pelvis_turn_deg"]) - float(other["pelvis_turn_deg"])) == pytest.approx(180, abs=1e-3)
        assert float(one["pelvis_tilt_deg"]) == pytest.approx(float(other["pelvis_tilt_deg"]), abs=1e-3)


def test_csv_tells_in_which_frames_a_foot_stands(even, tmp_path):
    with export(in_contact(even), tmp_path / "dance.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert "".join(row["l_foot_contact"] for row in rows) == "001111100000"
    assert "".join(row["r_foot_contact"] for row in rows) == "111000000111"
    none = replace(even, provenance={**even.provenance, "contacts": []})
    with export(none, tmp_path / "none_found.csv").open() as file:
        assert {row["l_foot_contact"] + row["r_foot_contact"] for row in csv.DictReader(file)} == {"00"}
    with export(even, tmp_path / "not_looked_for.csv").open() as file:
        assert set(rows[0]) - set(next(csv.reader(file))) == {"l_foot_contact", "r_foot_contact"}


def test_parquet_is_the_same_table_and_states_its_units(motion, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    table = parquet.read_table(export(motion, tmp_path / "dance.parquet"))
    with export(motion, tmp_path / "dance.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert table.column_names == list(rows[0])
    knees = table.column("r_knee_flex_deg").to_pylist()
    np.testing.assert_allclose(knees, [float(row["r_knee_flex_deg"]) for row in rows], atol=1e-5)
    assert table.schema.metadata[b"units"] == b"m"
    assert table.schema.metadata[b"frame_rate"] == b"varying"


def test_parquet_without_pyarrow_says_what_to_install(motion, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(InputError, match=r"pip install 'jaxmocap\[parquet\]'"):
        export(motion, tmp_path / "dance.parquet")
    assert list(tmp_path.iterdir()) == []


def test_colmap_is_read_back_as_the_same_cameras(motion, tmp_path):
    folder = export(motion, tmp_path / "shot.colmap")
    assert (folder / "images.txt").read_text().startswith("# units: m, up: y")
    again = read_cameras(folder, motion.cameras.names, len(motion), frames=np.tile(motion.frames, (2, 1)))
    np.testing.assert_allclose(again.cam_from_world, motion.cameras.cam_from_world, atol=1e-4)
    np.testing.assert_allclose(again.intrinsics, motion.cameras.intrinsics, rtol=1e-6)
    with pytest.raises(InputError, match="comes without any"):
        export(replace(motion, cameras=None), tmp_path / "none.colmap")


def test_colmap_reads_every_picture_of_cameras_with_blanks_in_their_names(motion, tmp_path):
    folder = export(
        replace(motion, cameras=replace(motion.cameras, names=("left phone", "right"))), tmp_path / "a.colmap"
    )
    script = (
        "import sys, pycolmap; print(*(x.name for x in pycolmap.Reconstruction(sys.argv[1]).images.values()), sep='|')"
    )
    command = [sys.executable, "-c", script, str(folder)]
    said = subprocess.run(command, check=True, timeout=120, capture_output=True, text=True).stdout
    expected = {f"{name}/{frame:05d}.png" for name in ("left_phone", "right") for frame in motion.frames}
    assert set(said.strip().split("|")) == expected
    same = replace(motion, cameras=replace(motion.cameras, names=("a b", "a_b")))
    with pytest.raises(InputError, match=r"b\.colmap would have two cameras of one name"):
        export(same, tmp_path / "b.colmap")


def test_colmap_cameras_are_of_the_videos_also_where_smaller_pictures_were_tracked(motion, tmp_path):
    recorded = [[2 * width, 2 * height] for width, height in motion.cameras.sizes]
    large = replace(motion, provenance={**motion.provenance, "recorded_sizes": recorded})
    folder = export(large, tmp_path / "shot.colmap")
    sizes = tuple((width, height) for width, height in recorded)
    again = read_cameras(folder, motion.cameras.names, len(motion), sizes, np.tile(motion.frames, (2, 1)))
    np.testing.assert_allclose(again.intrinsics[:, :2], 2 * motion.cameras.intrinsics[:, :2], rtol=1e-6)
