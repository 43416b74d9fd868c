"""Readers of files against random damage: how many inputs are taken, refused with a sentence, crash, or hang.

    python benchmarks/fuzz.py [--seconds 30] [--seed 0] [--keep FOLDER]

Every reader gets a sound file and, for so many seconds, copies of it with bytes flipped, cut out, repeated, or replaced
by numbers that files lie with. A crash is anything but an `InputError`; a hang is more than 10 seconds. Inputs that do
either are kept in FOLDER, and the exit code is 1. C3D and TRC are only written by us, never read.
"""

import argparse
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

import jaxmocap as jm
from jaxmocap._results import InputError
from jaxmocap.camera import write_cameras
from jaxmocap.capture._config import read_config
from jaxmocap.detection import read_people
from jaxmocap.exporters import export
from jaxmocap.importers import read_bvh, read_glb
from jaxmocap.synthetic import make_capture, write_capture

LONGEST = 10
_NUMBERS = ("-1", "0", "nan", "inf", "1e400", "99999999999999999999", "[" * 200, '"', "\0")
_WORDS = (b"\xff\xff\xff\xff", b"\0\0\0\0", b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\xc0\x7f")

Reader = Callable[[Path], object]


def damaged(data: bytes, draw: random.Random) -> bytes:
    """One to six small damages."""
    found = bytearray(data)
    for _ in range(draw.randint(1, 6)):
        place = draw.randrange(len(found) + 1)
        length = draw.choice((1, 2, 4, 8, 64, 1024))
        match draw.randrange(6):
            case 0:
                found[place : place + 1] = bytes([draw.randrange(256)])
            case 1:
                del found[place : place + length]
            case 2:
                found[place:place] = found[place : place + length]
            case 3:
                found[place : place + 4] = draw.choice(_WORDS)
            case 4:
                found[place : place + draw.randrange(4)] = draw.choice(_NUMBERS).encode()
            case _:
                head = draw.randrange(min(200, len(found)) + 1)  # where the lengths and counts of most files are
                found[head : head + 1] = bytes([draw.randrange(256)])
    return bytes(found)


def sound_files(folder: Path) -> dict[str, tuple[Path, Reader]]:
    """A sound file per reader, and what reads it."""
    shown = make_capture(2, (96, 64))
    capture = write_capture(shown, folder / "capture")
    motion = jm.Motion.from_poses(shown.character, shown.poses, np.arange(2), shown.timestamps, cameras=shown.cameras)
    export(motion, folder / "clip.bvh")
    export(motion, folder / "clip.glb")
    motion.save(folder / "result")
    write_cameras(shown.cameras, folder / "colmap", "colmap-binary")
    cameras = lambda path: jm.read_cameras(path.parent, shown.cameras.names, 2)  # noqa: E731
    return {
        "capture.toml": (capture / "capture.toml", read_config),
        "keypoints": (next(iter(sorted((capture / "keypoints").iterdir()))), read_people),
        "COLMAP cameras.bin": (folder / "colmap" / "cameras.bin", cameras),
        "COLMAP images.bin": (folder / "colmap" / "images.bin", cameras),
        "COLMAP cameras.txt": (capture / "cameras" / "cameras.txt", cameras),
        "COLMAP images.txt": (capture / "cameras" / "images.txt", cameras),
        "character GLB": (capture / "actor.glb", jm.Character.load),
        "clip GLB": (folder / "clip.glb", lambda path: read_glb(path, None, None)),
        "BVH": (folder / "clip.bvh", lambda path: read_bvh(path, None)),
        "motion.npz": (folder / "result" / "motion.npz", jm.Motion.load),
    }


class HangError(BaseException):
    """Past any `except Exception` of a reader."""


def _too_long(*_: object) -> None:
    raise HangError


def notice_hangs() -> None:
    """Raise `HangError` where an alarm goes off."""
    signal.signal(signal.SIGALRM, _too_long)


def attempt(path: Path, read: Reader, data: bytes, keep: Path, counts: Counter) -> None:
    """Read the file with these bytes, and count what became of it; the file is left so."""
    path.write_bytes(data)
    signal.alarm(LONGEST)
    try:
        found = read(path)
        refused = isinstance(found, tuple) and found and found[0] is None  # a configuration and its findings
        outcome = "refused" if refused else "taken"
    except InputError:
        outcome = "refused"
    except HangError:
        outcome = "hung"
    except Exception as error:
        outcome = "crashed"
        print(f"{path.name}: {type(error).__name__}: {error}"[:300], file=sys.stderr)
    finally:
        signal.alarm(0)
    counts[outcome] += 1
    if outcome in ("crashed", "hung"):
        keep.mkdir(parents=True, exist_ok=True)
        (keep / f"{outcome}_{counts[outcome]:03d}_{path.name}").write_bytes(data)


def fuzz(path: Path, read: Reader, seconds: float, draw: random.Random, keep: Path) -> Counter:
    """Counts of what became of the inputs."""
    sound, counts, end = path.read_bytes(), Counter(), time.monotonic() + seconds
    read(path)
    while time.monotonic() < end:
        attempt(path, read, damaged(sound, draw), keep, counts)
    path.write_bytes(sound)
    return counts


def row(name: str, counts: Counter) -> str:
    """A line of the table."""
    return f"{name:20s} " + ", ".join(f"{counts[o]:,} {o}" for o in ("taken", "refused", "crashed", "hung"))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=30.0, help="for each reader")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, default=Path("fuzz_findings"), help="folder for inputs that crash or hang")
    options = parser.parse_args()
    notice_hangs()
    total, draw = Counter(), random.Random(options.seed)
    with tempfile.TemporaryDirectory() as folder:
        for name, (path, read) in sound_files(Path(folder)).items():
            counts = fuzz(path, read, options.seconds, draw, options.keep)
            print(row(name, counts), flush=True)
            total += counts
    print(row("all", total))
    return int(total["crashed"] + total["hung"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
