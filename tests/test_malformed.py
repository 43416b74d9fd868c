"""Hundreds of spoilt inputs over every reader: each is refused with a sentence or taken, none crashes, hangs, or writes
where it should not."""

import itertools
import json
import random
import shutil
import struct
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from jaxmocap._cli import run
from jaxmocap.motion import Motion
from jaxmocap.synthetic import make_capture, write_capture

LONGEST = 10.0
"""Seconds."""
TAKEN, REFUSED = 0, 2
Damage = Callable[[Path], None]
SOURCES = ("capture.toml", "cam0.mp4", "cameras/images.txt", "cameras/cameras.txt", "actor.glb", "truth.npz")
SOURCES += ("keypoints/cam0_00000_keypoints.json", "masks/cam0_00000.png")


# Damages ----------------------------------------------------------------------------------------------------------


def content(data: bytes | str) -> Damage:
    """The file holds something else."""
    return lambda path: path.write_bytes(data.encode() if isinstance(data, str) else data) and None


def cut(share: float) -> Damage:
    return lambda path: path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)]) and None


def flipped(seed: int) -> Damage:
    """A few damaged bytes, one of them near the beginning."""

    def damage(path: Path) -> None:
        data, draw = bytearray(path.read_bytes()), random.Random(seed)
        for place in (draw.randrange(min(64, len(data))), *(draw.randrange(len(data)) for _ in range(6))):
            data[place] ^= draw.randrange(1, 256)
        path.write_bytes(bytes(data))

    return damage


def replaced(before: str, after: str) -> Damage:
    """A text with one passage changed, which must be there."""

    def damage(path: Path) -> None:
        text = path.read_text()
        assert before in text, before
        path.write_text(text.replace(before, after, 1))

    return damage


def folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def missing(path: Path) -> None:
    path.unlink()


def circle(path: Path) -> None:
    path.unlink()
    path.symlink_to(path)


def stranger(path: Path) -> None:
    """A link out of the capture, to a file that is none of ours."""
    path.unlink()
    path.symlink_to(__file__)


BYTES: dict[str, Damage] = {
    "empty": content(b""),
    "one byte": content(b"\0"),
    "zeros": content(bytes(5000)),
    "text": content("Once upon a time\n" * 50),
    "foreign alphabet": content("\ufeffʻāpana \u202egnp.exe\n" * 20),
    "half": cut(0.5),
    "all but the end": cut(0.97),
    **{f"flipped {seed}": flipped(seed) for seed in range(4)},
    "folder": folder,
    "missing": missing,
    "circle": circle,
    "stranger": stranger,
}

CAPTURE = {
    'up = "y"': ('up = "w"', "up = 3", "up = nan", 'up = "<b>y</b>"'),
    "fps = 30": ("fps = 0", "fps = -30", "fps = nan", "fps = inf", "fps = 1e400", 'fps = "30"', "fps = []"),
    "frames = 4": ("frames = -4", "frames = 10000000000000000000000", "frames = 4.5", "frames = true", "frames = 9"),
    'units = "metres"': ('units = "feet"', "units = 1", 'units = "metres"\nunits = "metres"'),
    'actor = "actor.glb"': (
        'actor = "../actor.glb"', 'actor = "/etc/passwd"', 'actor = "."', 'actor = ""', 'actor = "cam0.mp4"',
        'actor = "a\\u0000b.glb"', 'actor = "' + "a" * 5000 + '.glb"', 'actor = "keypoints"', "actor = [1]",
    ),
    'cameras = "cameras"': (
        'cameras = "../cameras"', 'cameras = "keypoints"', 'cameras = "truth.npz"', 'cameras = "nowhere"',
        'cameras = "cameras/../../.."', "cameras = {}",
    ),
    "selected_frames = [0, 2]": (
        "selected_frames = []", "selected_frames = [-1]", "selected_frames = [4]", "selected_frames = [0, 0]",
        "selected_frames = [0.5]", 'selected_frames = ["0"]', "selected_frames = 0",
        f"selected_frames = {list(range(5000))}",
    ),
    'keypoints = "keypoints"': ('keypoints = "actor.glb"', 'keypoints = "no"', "keypoints = 5", 'keypoints = "~"'),
    'masks = "masks"': ('masks = "cam0.mp4"', 'masks = "../.."', "masks = false"),
    'truth = "truth.npz"': ('truth = "actor.glb"', 'truth = "/dev/zero"', "truth = 0"),
    'name = "cam0"': (
        'name = "cam1"', 'name = ""', 'name = "../cam0"', 'name = "<script>alert(1)</script>"', "name = 0",
        'name = "cam0"\nname = "cam0"', 'name = "cam\\n0"',
    ),
    'video = "cam0.mp4"': (
        'video = "cam1.mp4"', 'video = "http://localhost/cam0.mp4"', 'video = "/dev/zero"', 'video = "actor.glb"',
        'video = "concat:cam0.mp4|cam1.mp4"', 'video = "no.mp4"', 'video = ""', "offset = 1",
        'video = "cam0.mp4"\noffset = nan', 'video = "cam0.mp4"\noffset = 1e300', 'video = "cam0.mp4"\noffset = -100',
        'video = "cam0.mp4"\ncolour = "red"',
    ),
    'name = "synthetic"': ('name = "<script>alert(1)</script>"', "name = " + "[" * 5000, "name = {}", 'name = ""'),
    "[[camera]]": ("[camera]", "[[camera", "[[camera]]\n" * 3, "[[cameras]]"),
}  # fmt: skip
KEYPOINTS = (
    "null", "[]", "{}", '{"people": 1}', '{"people": [1]}', '{"people": [{}]}', '{"people": []}', "NaN",
    '{"people": [{"pose_keypoints_2d": []}]}', '{"people": [{"pose_keypoints_2d": null}]}', "[" * 100_000,
    *(json.dumps({"people": [{"pose_keypoints_2d": [value] * 75}]}) for value in (-1, 1e300, 10**400, "1", None, [])),
    '{"people": [{"pose_keypoints_2d": [' + ", ".join(["NaN"] * 75) + "]}]}",
    '{"people": [{"pose_keypoints_2d": [' + ", ".join(["Infinity"] * 75) + "]}]}",
    json.dumps({"people": [{"pose_keypoints_2d": [0.5] * 51}]}),
    json.dumps({"people": [{"pose_keypoints_2d": [100.0, 80.0, 1.0] * 25}] * 3000}),
    '{"pose_landmarks": [[{"x": 0.5, "y": 0.5}]]}', '{"pose_landmarks": 1}', '{"pose_landmarks": [[1]]}',
    '[{"keypoints": [[1, 2]] * 17, "keypoint_scores": 1}]', '[{"keypoints": [], "keypoint_scores": []}]',
    '[{"keypoints": [[[1, 2]]], "keypoint_scores": [1]}]', '[{"keypoints": {}, "keypoint_scores": {}}]',
    '[{"image_id": "12.jpg", "keypoints": [1, 2, 3]}]', '[{"image_id": [], "keypoints": "x"}]', '[1]', '[{}]',
    '[{"frame_id": 1e400, "instances": []}]', '[{"frame_id": 0}, 1]', '{"instance_info": null}',
)  # fmt: skip
CAMERAS = (
    "1 PINHOLE 320 180 nan 300 160 90\n", "1 PINHOLE 320 180 -300 300 160 90\n", "1 PINHOLE 320 180\n",
    "1 PINHOLE 99999999 180 300 300 160 90\n", "1 FISHEYE_OF_MINE 320 180 300\n", "x y z\n",
    "1 PINHOLE -1 -1 1 1 1 1\n",
    "1 PINHOLE 320 180 0 0 0 0\n", "1 PINHOLE 320 180 inf inf 160 90\n", "1 PINHOLE 320 180 1e-30 1e-30 160 90\n",
    "1 PINHOLE 320 180 300 300 160 90\n" * 2, "9223372036854775808 PINHOLE 320 180 300 300 160 90\n",
)  # fmt: skip
IMAGES = (
    "1 0 0 0 0 0 0 0 1 cam0/00000.png\n\n", "1 1 0 0 0 nan 0 0 1 cam0/00000.png\n\n", "1 1 0 0 0 0 0\n\n",
    "1 1 0 0 0 0 0 0 77 cam0/00000.png\n\n", "1 1 0 0 0 0 0 0 1 ../../etc/passwd\n\n",
    "1 1 0 0 0 1e30 0 0 1 cam0/00000.png\n\n", "1 2 3 4 5 0 0 0 1 cam0/00000.png\n\n",
    "1 1 0 0 0 0 0 0 1 cam0/-0001.png\n\n", "1 1 0 0 0 0 0 0 1 cam0/99999999999999999999.png\n\n",
)  # fmt: skip
POSES = (
    "", "[]", "{", "{}", '{"0": 3}', '{"0": {"no_such_dof": 1}}', '{"0": {"l_elbow_flex": "x"}}',
    '{"0": {"l_elbow_flex": NaN}}', '{"0": {"l_elbow_flex": 1e99}}', '{"-1": {"l_elbow_flex": 1}}',
    '{"one": {"l_elbow_flex": 1}}',
    '{"' + "9" * 5000 + '": {}}', '{"0": {"l_elbow_flex": 1' + "0" * 4000 + "}}",
    '{"3": {"l_elbow_flex": 1}}', "[" * 100_000, '{"0": {"l_elbow_flex": Infinity}}',
)  # fmt: skip
BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 0 90 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Chest
  {
    OFFSET 0 20 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 10 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.033333
0 90 0 0 0 0 0 0 0
0 90 0 0 0 0 0 0 0
"""
BVH_CHANGES = {
    "Frames: 2": ("Frames: -2", "Frames: 0", "Frames: 99999999999", "Frames: x", "Frames:", "Frames: 3", "Frames: nan"),
    "Frame Time: 0.033333": ("Frame Time: 0", "Frame Time: -1", "Frame Time: nan", "Frame Time: inf", "Frame Time:"),
    "OFFSET 0 20 0": ("OFFSET 0 20", "OFFSET 0 nan 0", "OFFSET a b c", "OFFSET 1e300 0 0", "OFFSET 0 20 0 0"),
    "CHANNELS 3": ("CHANNELS -3", "CHANNELS 4", "CHANNELS 99999999", "CHANNELS x"),
    "JOINT Chest": ("JOINT", "JOINT <b>", "JOINT Hips", "JOINT Chest {" * 2000, "Chest"),
    "0 90 0 0 0 0 0 0 0\n0": ("nan 90 0 0 0 0 0 0 0\n0", "0 90 0\n0", "a b c\n0", "1e300 1e300 0 0 0 0 0 0 0\n0"),
    "MOTION": ("", "HIERARCHY", "}\nMOTION"),
    "ROOT Hips": ("ROOT", "", "ROOT Hips\nROOT Hips"),
}


# Inputs that lie about their size ---------------------------------------------------------------------------------


def lying_npz(path: Path) -> None:
    """An array that says it has 10^15 numbers."""
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000000,), }"
    header += b" " * (118 - len(header)) + b"\n"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("markers.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header)


def pickled_npz(path: Path) -> None:
    np.savez(path, markers=np.array([{"a": 1}], dtype=object))


def shaped_npz(*shape: int, value: float = 0.0) -> Damage:
    return lambda path: np.savez(path, markers=np.full(shape, value))


def lying_png(path: Path) -> None:
    """A picture that says it is 2^31 - 1 pixels wide and high."""
    data = bytearray(path.read_bytes())
    data[16:24] = struct.pack(">II", 2**31 - 1, 2**31 - 1)
    path.write_bytes(bytes(data))


def lying_glb(length: int, chunk: int) -> Damage:
    def damage(path: Path) -> None:
        data = bytearray(path.read_bytes())
        data[8:16] = struct.pack("<II", length, chunk)
        path.write_bytes(bytes(data))

    return damage


def edited_glb(change: Callable[[dict], object]) -> Damage:
    """The JSON of a GLB changed, its length kept right."""

    def damage(path: Path) -> None:
        data = path.read_bytes()
        (length,) = struct.unpack_from("<I", data, 12)
        document = json.loads(data[20 : 20 + length])
        change(document)
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        body = struct.pack("<I4s", len(text), b"JSON") + text + data[20 + length :]
        path.write_bytes(data[:8] + struct.pack("<I", 12 + len(body)) + body)

    return damage


GLB: dict[str, Damage] = {
    "length 4 GiB": lying_glb(2**32 - 1, 2**32 - 4),
    "chunk 0": lying_glb(20, 0),
    "count 10^12": edited_glb(lambda g: g["accessors"][0].update(count=10**12)),
    "count -1": edited_glb(lambda g: g["accessors"][0].update(count=-1)),
    "offset beyond": edited_glb(lambda g: g["bufferViews"][0].update(byteOffset=10**9)),
    "no accessors": edited_glb(lambda g: g.pop("accessors")),
    "joint that is none": edited_glb(lambda g: g["skins"][0]["joints"].append(10**6)),
    "nodes in a circle": edited_glb(lambda g: [n.update(children=[0]) for n in g["nodes"]]),
    "foreign file": edited_glb(lambda g: g["buffers"][0].update(uri="../../../../etc/passwd")),
    "address": edited_glb(lambda g: g["buffers"][0].update(uri="http://localhost:1/x.bin")),
    "no mesh": edited_glb(lambda g: g.update(meshes=[])),
    "version 9": edited_glb(lambda g: g["asset"].update(version="9.0")),
    "deep": edited_glb(lambda g: g.update(extras=json.loads("[" * 400 + "]" * 400))),
    "names with tags": edited_glb(lambda g: [n.update(name="<img src=x onerror=alert(1)>") for n in g["nodes"]]),
    "matrix of NaN": edited_glb(lambda g: g["nodes"][0].update(scale=[float("nan")] * 3)),
}
TRUTHS: dict[str, Damage] = {
    "lying": lying_npz,
    "pickled": pickled_npz,
    "no frames": shaped_npz(0, 44, 3),
    "two axes": shaped_npz(4, 3),
    "four numbers": shaped_npz(4, 44, 4),
    "NaN": shaped_npz(4, 44, 3, value=np.nan),
    "inf": shaped_npz(4, 44, 3, value=np.inf),
    "other frames": shaped_npz(400, 2, 3),
    "no names": lambda path: np.savez(path, joints=np.zeros((4, 3, 3))),
    "nothing": lambda path: np.savez(path),
}


# The corpus -------------------------------------------------------------------------------------------------------


def corpus() -> list:
    """Every case: its name, the verb, the file, the damage."""
    cases: list[tuple[str, str, str, Damage]] = []
    for name, (kind, damage) in itertools.product(SOURCES, BYTES.items()):
        cases.append((f"{kind}", "check", name, damage))
    for before, changes in CAPTURE.items():
        cases += [(text[:40], "check", "capture.toml", replaced(before, text)) for text in changes]
    for name in ("keypoints/cam0_00000_keypoints.json", "keypoints/cam0.json"):
        cases += [(text[:40], "check", name, content(text)) for text in KEYPOINTS]
    cases += [(text[:40], "cameras", "cameras/cameras.txt", content(text)) for text in CAMERAS]
    cases += [(text[:40], "cameras", "cameras/images.txt", content(text)) for text in IMAGES]
    cases += [(text[:40], "track --pose", "pose.json", content(text)) for text in POSES]
    cases += [(kind, "track --actor", "actor.glb", damage) for kind, damage in (BYTES | GLB).items()]
    cases += [("gigapixel", "check", "masks/cam0_00000.png", lying_png)]
    cases += [(kind, "evaluate --truth", "truth.npz", damage) for kind, damage in (BYTES | TRUTHS).items()]
    cases += [(kind, "evaluate", "result/motion.npz", damage) for kind, damage in (BYTES | TRUTHS).items()]
    cases += [(kind, "export", "result/motion.npz", damage) for kind, damage in BYTES.items()]
    cases += [(kind, "read-motion", "clip.bvh", damage) for kind, damage in BYTES.items()]
    for before, changes in BVH_CHANGES.items():
        cases += [(text[:40] or "none", "read-motion", "clip.bvh", replaced(before, text)) for text in changes]
    cases += [(kind, "read-motion", "clip.glb", damage) for kind, damage in (BYTES | GLB).items()]
    marks = (), pytest.mark.slow, pytest.mark.slow  # every third each time
    return [
        pytest.param(*case[1:], id=f"{case[1]}-{case[2]}-{case[0]}", marks=marks[number % 3])
        for number, case in enumerate(cases)
    ]


CASES = corpus()


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    """Everything as it should be; copied before it is spoilt."""
    base = tmp_path_factory.mktemp("sound")
    shown = make_capture(4, (320, 180))
    write_capture(shown, base / "capture")
    motion = Motion.from_poses(shown.character, shown.poses, np.arange(4), shown.timestamps, cameras=shown.cameras)
    motion.save(base / "capture" / "result")
    (base / "capture" / "clip.bvh").write_text(BVH)
    shutil.copy(base / "capture" / "actor.glb", base / "capture" / "clip.glb")
    (base / "capture" / "pose.json").write_text('{"0": {"l_elbow_flex": 30}}')
    return base / "capture"


def arguments(verb: str, capture: Path, file: Path, out: Path) -> list[str]:
    """The command that reads the file."""
    match verb.split():
        case ["check" | "cameras" as word]:
            return [word, str(capture)]
        case ["track", option]:
            return ["track", str(capture), "--out", str(out / "r"), option, str(file), "--no-cache", "--frames", "0:1"]
        case ["evaluate", option]:
            return ["evaluate", str(capture / "result"), option, str(file)]
        case ["evaluate"]:
            return ["evaluate", str(capture / "result"), "--truth", str(capture / "truth.npz")]
        case ["export"]:
            return ["export", str(capture / "result"), "--to", str(out / "m.csv")]
        case ["read-motion"]:
            return ["read-motion", str(file), "--out", str(out / "m"), "--actor", str(capture / "actor.glb")]
    raise AssertionError(verb)


def tree(folder: Path) -> dict[str, tuple[int, int]]:
    """Every file with its size and time."""
    found = {}
    for path in folder.rglob("*"):
        status = path.lstat()
        found[str(path)] = (status.st_size, status.st_mtime_ns) if path.is_file() else (0, 0)
    return found


def test_the_corpus_is_large():
    assert len(CASES) > 430


class Begun(Exception):
    """The inputs were taken."""


def begin(*_, **__):
    raise Begun


def test_the_sound_inputs_are_taken(sound, tmp_path, capsys, monkeypatch):
    """Otherwise a refusal would say nothing about the damage. The clips have no motion that fits, and are left out."""
    monkeypatch.setattr("jaxmocap.pipeline._track_capture.register_and_learn", begin)
    for verb, name in sorted({case.values[:2] for case in CASES}):
        words = arguments(verb, sound, sound / name, tmp_path / verb.replace(" ", "_"))
        if verb.startswith("track"):
            with pytest.raises(Begun):
                run(words)
        elif verb != "read-motion":
            assert run(words) == TAKEN, (words, capsys.readouterr().err)


@pytest.mark.parametrize(("verb", "name", "damage"), CASES)
def test_it_is_refused_or_taken(sound, tmp_path, capsys, monkeypatch, verb, name, damage):
    """`track` is stopped where the selected frames would be registered."""
    monkeypatch.setattr("jaxmocap.pipeline._track_capture.register_and_learn", begin)
    capture = Path(shutil.copytree(sound, tmp_path / "in" / "capture"))
    damage(capture / name)
    before, start = tree(tmp_path / "in"), time.perf_counter()
    try:
        code = run(arguments(verb, capture, capture / name, tmp_path / "out"))
    except Begun:
        code = TAKEN
    took, err = time.perf_counter() - start, capsys.readouterr().err
    assert code in (TAKEN, REFUSED)
    assert "Traceback" not in err
    if code == REFUSED and verb != "check":  # which prints a table
        sentence = err.splitlines()[-1]
        assert sentence.startswith("jaxmocap: ")
        assert len(sentence) < 1000
    assert took < LONGEST
    assert tree(tmp_path / "in") == before
    assert {path.name for path in tmp_path.iterdir()} <= {"in", "out"}
    if code == REFUSED:
        assert not (tmp_path / "out").exists() or not any((tmp_path / "out").rglob("*.*"))
