"""Films of one small world: a square that wanders over a wall, a lamp that flashes, and noise that can be inlier.

Every film is of the same world time; its own clock starts at `start` and may run too fast. So the offset of one film
against another is known: the difference of their starts.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

SIZE = (160, 120)
RATE = 48_000
_random = np.random.default_rng(7)
_WALL = np.kron(_random.uniform(60, 120, (30, 40)), np.ones((8, 8)))
_NOISE = _random.normal(0, 0.1, 60 * RATE).astype(np.float32)
_PATH = np.cumsum(np.cumsum(_random.normal(0, 1, (2, 600)), axis=1), axis=1)


def inlier(seconds: np.ndarray) -> np.ndarray:
    """The sound of the world, from 0 to 60 s."""
    return np.interp(seconds * RATE, np.arange(len(_NOISE)), _NOISE).astype(np.float32)


def place(second: float) -> tuple[float, float]:
    """Where the square's corner is, in pixels: two wandering sums of oscillations."""
    wave = lambda phase: sum(np.sin(f * 2 * np.pi * second + phase * f) for f in (0.43, 1.1, 1.7, 2.3))  # noqa: E731
    return 60 + 14 * wave(1.0), 45 + 11 * wave(2.7)


@dataclass(frozen=True)
class Film:
    """How a film is made. `times` are the frames' own times, `readout` the share of 1 / 30 s in which the lines are
    read from top to bottom; `shake` moves the camera; the first `black` frames are black, and the next `fade` ones ever
    less dark; `sound` is "noise", "other", "silence", "beeps" or None."""

    start: float = 0.0
    times: tuple[float, ...] = tuple(i / 30 for i in range(75))
    flashes: tuple[float, ...] = ()
    readout: float = 0.75
    shake: float = 0.0
    light: float = 1.0
    black: int = 0
    fade: int = 0
    moves: bool = True
    backwards: bool = False
    sound: str | None = None
    sound_late: float = 0.0
    sound_rate: int = RATE
    channels: str = "mono"
    drift: float = 0.0
    rotation: int = 0


def rate(count: int, per_second: float) -> tuple[float, ...]:
    return tuple(i / per_second for i in range(count))


def picture(film: Film, own: float) -> np.ndarray:
    """Brightness in [0, 255], lines read one after the other."""
    width, height = SIZE
    world = film.start + own * (1 + film.drift)
    shift = np.rint(film.shake * np.array([np.sin(7 * own + film.start), np.cos(5 * own)])).astype(int) + 20
    image = _WALL[shift[1] : shift[1] + height, shift[0] : shift[0] + width].copy()
    if film.moves:
        x, y = place(30 - world if film.backwards else world)
        left, top = (round(v - s + 20) for v, s in zip((x, y), shift, strict=True))
        image[max(top, 0) : max(top + 30, 0), max(left, 0) : max(left + 24, 0)] = 175
    lines = world + np.arange(height) / height * film.readout / 30
    for flash in film.flashes:
        image[(lines >= flash) & (lines < flash + 0.05)] += 70
    return np.clip(image * film.light, 0, 255)


def sound_of(film: Film, seconds: float) -> np.ndarray:
    own = film.sound_late + np.arange(int(seconds * film.sound_rate)) / film.sound_rate
    world = film.start + own * (1 + film.drift)
    if film.sound == "silence":
        return np.zeros(len(own), np.float32)
    if film.sound == "beeps":
        return (0.3 * np.sin(2 * np.pi * 1000 * world) * (world % 0.5 < 0.1)).astype(np.float32)
    microphone = np.random.default_rng([int(1000 * film.start), film.sound_rate, film.sound == "other"])
    world = 55 - world if film.sound == "other" else world
    return (inlier(world) + microphone.normal(0, 0.05, len(own))).astype(np.float32)


def make_film(path: Path, film: Film) -> Path:
    """Write the film; H.264 with AAC in .mp4, with raw sound in .mkv."""
    with av.open(str(path), "w") as container:
        pictures = container.add_stream("libx264", rate=30, options={"crf": "14", "preset": "ultrafast"})
        pictures.width, pictures.height, pictures.pix_fmt = *SIZE, "yuv420p"
        pictures.codec_context.time_base = pictures.time_base = Fraction(1, 90_000)
        if film.rotation:
            pictures.set_display_rotation(film.rotation)
        track = None
        if film.sound is not None:
            track = container.add_stream("aac" if path.suffix == ".mp4" else "pcm_s16le", rate=film.sound_rate)
            track.layout = film.channels
        for number, own in enumerate(film.times):
            shown = np.clip((number - film.black + 1) / (film.fade + 1), 0, 1) * picture(film, own)
            frame = av.VideoFrame.from_ndarray(shown.astype(np.uint8), format="gray").reformat(format="yuv420p")
            frame.pts, frame.time_base = round(own * 90_000), Fraction(1, 90_000)
            container.mux(pictures.encode(frame))
        container.mux(pictures.encode())
        if track is not None:
            _write_sound(container, track, film)
    return path


def _write_sound(container, track, film: Film) -> None:
    samples = sound_of(film, film.times[-1] - film.sound_late)
    late, step = round(film.sound_late * film.sound_rate), 1024
    for begin in range(0, len(samples), step):
        mono = samples[begin : begin + step]
        data = np.stack([mono] * (2 if film.channels == "stereo" else 1)).T.reshape(1, -1)
        frame = av.AudioFrame.from_ndarray(np.ascontiguousarray(data), format="flt", layout=film.channels)
        frame.sample_rate, frame.pts, frame.time_base = film.sound_rate, late + begin, Fraction(1, film.sound_rate)
        container.mux(track.encode(frame))
    container.mux(track.encode())


def make_capture(folder: Path, films: Sequence[Film], suffix: str = ".mp4") -> Path:
    """A capture folder without cameras, with a comment to keep."""
    folder.mkdir()
    sections = []
    for number, film in enumerate(films):
        make_film(folder / f"cam{number}{suffix}", film)
        sections.append(f'[[camera]]\nname = "cam{number}"\nvideo = "cam{number}{suffix}"   # phone {number}\n')
    (folder / "capture.toml").write_text('name = "films"  # keep me\nfps = 30\n\n' + "\n".join(sections))
    return folder
