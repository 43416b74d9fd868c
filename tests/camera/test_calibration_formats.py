"""Reading the calibrations of other programs: known rigs, and one sentence for everything that is wrong."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from calibration_files import FILES, NAMES, POSES, SIZES, check_rig, put

from jaxmocap._results import InputError
from jaxmocap.camera import read_cameras

FIXED_UNITS = ("freemocap", "qualisys")


def _sentence(path: Path, names: tuple[str, ...] = NAMES, **arguments) -> str:
    with pytest.raises(InputError) as caught:
        read_cameras(path, names, 2, **({"sizes": SIZES} | arguments))
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("form", FILES)
def test_the_same_rig_is_read_from_every_form(tmp_path: Path, form: str):
    check_rig(read_cameras(put(tmp_path, form), NAMES, 3, SIZES), 2e-6)


@pytest.mark.parametrize("form", FILES)
def test_cameras_come_in_the_order_asked_for_and_others_are_ignored(tmp_path: Path, form: str):
    cameras = read_cameras(put(tmp_path, form), ("right",), 1, SIZES[1:])
    np.testing.assert_allclose(cameras.cam_from_world[0, 0], POSES[1], atol=2e-6)


@pytest.mark.parametrize("form", FILES)
def test_units_of_the_capture_count_where_the_form_has_none(tmp_path: Path, form: str):
    cameras = read_cameras(put(tmp_path, form), NAMES, 1, SIZES, metres_per_unit=0.01)
    scale = 1.0 if form in FIXED_UNITS else 0.01
    np.testing.assert_allclose(cameras.centres()[0, 0], scale * np.array([0.5, 1, 4]), rtol=1e-5)


@pytest.mark.parametrize("form", FILES)
def test_a_missing_camera_is_named(tmp_path: Path, form: str):
    sentence = _sentence(put(tmp_path, form), ("left", "third"))
    assert "no camera called third; its cameras are: left" in sentence


@pytest.mark.parametrize("form", FILES)
def test_videos_of_another_size_are_named(tmp_path: Path, form: str):
    path = put(tmp_path, form)
    if form == "openpose":  # which keeps no sizes
        assert read_cameras(path, NAMES, 1, [(540, 960), (640, 480)]).sizes[0] == (540, 960)
        return
    sentence = _sentence(path, sizes=[(540, 960), (640, 480)])
    assert re.search(r"camera left is calibrated for 960x540 .* video has 540x960; the sides are swapped", sentence)


@pytest.mark.parametrize("form", FILES)
def test_a_file_cut_anywhere_is_refused_by_name_or_whole_for_these_cameras(tmp_path: Path, form: str):
    path = put(tmp_path, form)
    name, text = list(FILES[form].items())[-1]
    for end in range(0, len(text.rstrip()), len(text) // 40):
        (tmp_path / name).write_text(text[:end])
        sentence = ""
        try:
            check_rig(read_cameras(path, NAMES, 1, SIZES), 2e-6)
        except InputError as error:
            sentence = str(error)
        assert not sentence or path.name in sentence
        assert "\n" not in sentence


@pytest.mark.parametrize(
    ("form", "changes", "words"),
    [
        ("freemocap", ("= 58.0", "= 1"), ["charuco_square_size = 1", "expected millimetres"]),
        ("freemocap", ("3.141592653589793, 0.0", "3.14, nan"), ["camera left", "rotation is not finite"]),
        ("freemocap", ("-500.0,", "inf,"), ["camera left", "translation is not finite"]),
        ("qualisys", ('r33="1.0"', 'r33="-1.0"'), ["camera left", "determinant -1", "mirrored"]),
        ("qualisys", ('r33="1.0"', 'r33="0.0"'), ["camera left", "not orthonormal"]),
        ("qualisys", ('r33="1.0"', 'r33="nan"'), ["camera left", "r33 = 'nan'", "finite number"]),
        ("qualisys", ('x="500.0"', 'x="inf"'), ["camera left", "x = 'inf'", "finite number"]),
        ("qualisys", ('x="500.0"', 'x="east"'), ["camera left", "x = 'east'", "finite number"]),
        ("qualisys", ('r12="0.0" ', ""), ["camera left", "<transform> has no r12"]),
        ("qualisys", ("<transform x", "<transforms x"), ["camera left has no <transform>"]),
        ("qualisys", ('U="57600.0"', 'U="0"'), ["camera left", "focal length is 0"]),
        ("qualisys", ('U="57600.0"', 'U="-57600.0"'), ["camera left", "mirror the image"]),
        ("qualisys", ('skew="0.0"', 'skew="64"'), ["camera left", "skew of 64"]),
        ("qualisys", ('<fov_video left="0"', '<fov_video left="1000"'), ["camera left", "spans -40x540"]),
        ("qualisys", ('serial="right"', 'serial="left"'), ["no camera called right"]),
        ("qualisys", ('x="500.0"', 'x="900000.0"'), ["left and right", "files of this form are in millimetres"]),
        ("opencv-yaml", ("rows: 3", "rows: 300000"), ["rig.yml", "matrix of 300000 rows and 3 cols with 9 numbers"]),
        ("opencv-yaml", ("9.0100000000000000e+02,", ""), ["rig.yml", "3 rows and 3 cols with 8 numbers"]),
        ("opencv-yaml", ("9.0100000000000000e+02", ".Nan"), ["camera left", "finite"]),
        ("opencv-yaml", ("   rvec:", "   direction:"), ["camera left has no R"]),
        ("opencv-yaml", ("   tvec:", "   place:"), ["camera left has no T"]),
        ("opencv-yaml", ("   camera_matrix:", "   lens:"), ["no camera called left", "right"]),
        ("opencv-yaml", ("0., 0., -1., 0., -1., 0.", "0., 0., 1., 0., -1., 0."), ["camera right", "determinant -1"]),
        ("opencv-yaml", ("0., 0., -1., 0., -1., 0.", "0., 0., 0., 0., 0., 0."), ["camera right", "not orthonormal"]),
        ("opencv-yaml", ("%YAML:1.0\n---\n", ""), ["rig.yml", "does not begin with %YAML"]),
        ("opencv-yaml", ("   rvec:", "   camera_matrix:"), ["rig.yml", "camera_matrix twice"]),
        ("opencv-yaml", ("tvec: !!opencv-matrix", "tvec: &a [1, *a]\n   t:"), ["rig.yml", "has aliases"]),
        (
            "opencv-yaml",
            ("tvec: !!opencv-matrix", "tvec: !!python/object/apply:os.abort []\n   at:"),
            ["tvec has shape 0"],
        ),
        ("opencv-yaml", ("   rvec:", "   ? [a]\n   : 1\n   rvec:"), ["rig.yml", "keys that are no names"]),
        ("opencv-yaml", ("   rvec:", "rvec:"), ["rig.yml", "cut off or malformed"]),
        ("opencv-xml", ("<opencv_storage>", '<!DOCTYPE a [<!ENTITY b "c">]><opencv_storage>'), ["rig.xml", "DOCTYPE"]),
        ("opencv-xml", ("960 540", "960 wide"), ["camera left", "image_size is not an array of numbers"]),
        ("opencv-xml", ("<name>left", "<name>right"), ["no camera called left"]),
        ("opencv-json", ('"t": [-0.5, 1, 4]', '"t": [-0.5, 1]'), ["camera left", "t has shape 2", "expected 3"]),
        ("opencv-json", ('"t": [-0.5, 1, 4]', '"t": "here"'), ["camera left", "t is not an array of numbers"]),
        ("opencv-json", ('"right"', '"left"'), ["rig.json", "left twice"]),
        ("opencv-json", ("900, 0, 479.5", "9" * 400 + ", 0, 479.5"), ["camera left", "not an array of numbers"]),
        ("opencv-json", ("900, 0, 479.5", "9e99, 0, 479.5"), ["camera left", "finite numbers of a sensible size"]),
        ("opencv-json", ("900, 0, 479.5", "null, 0, 479.5"), ["camera left", "finite"]),
        ("opencv-xml", ("<rvec>", "<tvec>0. 0. 0.</tvec><rvec>"), ["rig.xml", "tvec twice"]),
        ("opencv-json", ("[0, 901, 269.5]", "[0, 901]"), ["camera left", "cameraMatrix is not an array of numbers"]),
        (
            "opencv-json",
            ("900, 0, 479.5], [0, 901, 269.5], [0, 0,", "900, 0, 0], [0, 901, 0], [479.5, 269.5,"),
            ["transp"],
        ),
        ("opencv-json", ("0.004, 0.05]", "0.004, 0.05, 0.1, 0, 0]"), ["camera right", "beyond k1 k2 p1 p2 k3"]),
        ("opencv-json", ('"R": [[1', '"rvec": [3, 0, 1], "R": [[1'), ["camera left", "R and rvec are different"]),
    ],
)
def test_calibrations_that_cannot_be_true_are_refused_by_file_and_camera(
    tmp_path: Path, form: str, changes: tuple[str, str], words: list[str]
):
    sentence = _sentence(put(tmp_path, form, changes))
    assert sentence.startswith(("recording", "calibration", "rig"))
    for word in words:
        assert word in sentence


@pytest.mark.parametrize(
    ("changes", "file", "words"),
    [
        (("K_left", "M_left"), "intri", ["calib/intri.yml camera left has no K"]),
        (("901.000000", "0.000000"), "intri", ["camera left", "focal length is 0"]),
        (("H_left", "h_left"), "intri", ["calib/intri.yml camera left has no H"]),
        (('- "left"', '- "middle"'), "intri", ["calib/intri.yml has no camera called left", "middle, right"]),
        (("names:", "cameras:"), "extri", ["calib/extri.yml has no list of names"]),
        (("3.141593", "3.0"), "extri", ["calib/extri.yml camera left", "R and Rot are different"]),
        (("T_right", "t_right"), "extri", ["calib/extri.yml camera right has no T"]),
        (("cols: 5", "cols: 4"), "intri", ["calib/intri.yml", "1 rows and 4 cols with 5 numbers"]),
    ],
)
def test_easymocap_s_files_are_refused_by_file_and_camera(tmp_path, changes: tuple[str, str], file: str, words):
    sentence = _sentence(put(tmp_path, "easymocap", changes, f"calib/{file}.yml"))
    for word in words:
        assert word in sentence


def test_easymocap_s_pair_is_found_by_its_folder_or_either_file_and_needs_both(tmp_path: Path):
    folder = put(tmp_path, "easymocap")
    for name in ("intri.yml", "extri.yml"):
        check_rig(read_cameras(folder / name, NAMES, 1, SIZES), 2e-6)
    intrinsics, extrinsics = (folder / name for name in ("intri.yml", "extri.yml"))
    content = intrinsics.read_text(), extrinsics.read_text()
    intrinsics.write_text(content[1])
    extrinsics.write_text(content[0])
    assert "calib/intri.yml camera left has R and no K" in _sentence(folder)
    assert "swapped" in _sentence(folder)
    extrinsics.unlink()
    assert "calib/ has intri.yml but no extri.yml" in _sentence(folder)


def test_a_file_per_camera_is_called_after_it(tmp_path: Path):
    folder = put(tmp_path, "openpose")
    (folder / "right.xml").rename(folder / "links.xml")
    assert "cameraParameters/ has no camera called right" in _sentence(folder)
    flat = read_cameras(folder / "left.xml", ("left",), 1, SIZES[:1])
    np.testing.assert_allclose(flat.cam_from_world[0, 0], POSES[0], atol=1e-6)


def test_two_cameras_of_one_name_are_refused(tmp_path: Path):
    path = put(tmp_path, "aniposelib", ('name = "right"', 'name = "left"'))
    assert "calibration.toml has several cameras called left" in _sentence(path, ("left",), sizes=SIZES[:1])


def test_squares_of_a_freemocap_board_in_metres_leave_the_units_to_the_capture(tmp_path: Path):
    path = put(tmp_path, "freemocap", ("= 58.0", "= 0.058"))
    np.testing.assert_allclose(
        read_cameras(path, NAMES, 1, SIZES, metres_per_unit=0.001).centres()[1, 0], [4, 1, 0.5], atol=1e-5
    )


@pytest.mark.parametrize("name", ["cameras.pickle", "cameras.bin.txt"])
def test_pickles_are_never_loaded(tmp_path: Path, name: str):
    import pickle

    class Bomb:
        def __reduce__(self):
            return (Path.write_text, (tmp_path / "exploded", "boom"))

    (tmp_path / name).write_bytes(pickle.dumps(Bomb()))
    assert f"{name} is a pickle" in _sentence(tmp_path / name)
    assert not (tmp_path / "exploded").exists()


@pytest.mark.parametrize("name", ["rig.yml", "rig.toml", "rig.qca.txt"])
def test_absurdly_large_files_are_refused_before_they_are_read(tmp_path: Path, name: str):
    with open(tmp_path / name, "wb") as file:
        file.truncate(2**34)
    assert f"{name} has 16384 MB; expected a calibration file of at most 4 MB" in _sentence(tmp_path / name)


@pytest.mark.parametrize(
    "text",
    [
        '{"a": ' + "[" * 100_000,
        "%YAML:1.0\n---\na: " + "[" * 100_000,
        "%YAML:1.0\n---\na: " + "- " * 100_000,
        "%YAML:1.0\n---\n" + "".join(" " * depth + "a:\n" for depth in range(300)),
        "<opencv_storage>" + "<a>" * 100_000,
        "a = " + "[" * 100_000,
    ],
    ids=["json", "yaml brackets", "yaml dashes", "yaml maps", "xml", "toml"],
)
def test_deep_nesting_is_refused_without_a_crash(tmp_path: Path, text: str):
    (tmp_path / "rig").write_text(text)
    code = (
        "import sys, pathlib; from jaxmocap import InputError; from jaxmocap.camera import read_cameras\n"
        "try: read_cameras(pathlib.Path(sys.argv[1]), ('a',), 1)\nexcept InputError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path / "rig")], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("rig ")
    assert done.stdout.count("\n") == 1
