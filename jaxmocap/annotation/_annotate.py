"""The page on which keypoints are set by hand: what it asks for, and what it is answered."""

import base64
import hashlib
import html
import os
import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from jaxmocap._results import InputError
from jaxmocap.capture import Capture, choose_frames, config_path
from jaxmocap.viewers import jpeg_bytes

from ._editor import Change, KeypointEditor
from ._epipolar import EpipolarGeometry
from ._points import asked_points, bones
from ._server import Answer, LocalServer, Refused, json_answer

_SCRIPTS = ("views.js", "points.js", "page.js")
_QUALITY = 92


def annotate(
    capture: Capture | str | os.PathLike[str],
    *,
    frames: Sequence[int] | None = None,
    cameras: Sequence[str] | None = None,
    port: int = 8070,
) -> "AnnotationPage":
    """Serve a page to this machine alone on which keypoints are set by hand, and return at once.

    Whoever knows the page's `url`, which holds a random token, sees the images, until `stop` is called. `frames` are
    positions in the capture, by default its selected frames, or else those that `choose_frames` takes, or else the
    first and the middle one; the page goes to any other. `cameras` are the views shown at first. Where `port` is taken
    the next free one is used.

    Every change is written at once (`KeypointEditor`). Raises `InputError` for frames or cameras that are not there,
    for a capture that cannot be read or written to, and if no port is free.
    """
    if isinstance(capture, Capture):
        opened, file = capture, config_path(capture.folder)
    else:
        file = config_path(Path(capture))
        opened = Capture.open(file)
    if not 0 <= port <= 65535:
        raise InputError(f"the port is {port}; a number from 0 to 65535 was expected, such as 8070.")
    folder = opened.keypoints_folder or file.parent
    if not os.access(folder, os.W_OK):
        raise InputError(f"{folder} cannot be written to; copy the capture to a place of your own")
    wrong = [name for name in cameras or () if name not in opened.camera_names]
    if wrong:
        raise InputError(
            f"capture '{opened.name}' has no camera {wrong[0]!r}; its cameras are {', '.join(opened.camera_names)}"
        )
    outside = [frame for frame in frames or () if not 0 <= frame < opened.num_frames]
    if outside:
        raise InputError(
            f"frame {outside[0]} is outside capture '{opened.name}', which has 0 to {opened.num_frames - 1}"
        )
    chosen = tuple(dict.fromkeys(frames)) if frames else _frames_of(opened)
    return AnnotationPage(KeypointEditor(opened, file), chosen, tuple(cameras or opened.camera_names), port)


class AnnotationPage:
    """A page that `annotate` serves."""

    def __init__(self, editor: KeypointEditor, frames: tuple[int, ...], cameras: tuple[str, ...], port: int):
        self._editor, self.frames, self._shown = editor, frames, cameras
        capture = editor.capture
        self._pictures = replace(capture, cameras_path=None, longest_side=None)  # as recorded, like keypoint files
        calibrated = capture.cameras_path is not None
        self._geometry = EpipolarGeometry(capture.as_recorded().cameras) if calibrated else None
        self._ended = threading.Event()
        self._server = LocalServer(
            {
                ("GET", ""): self._page,
                ("GET", "state"): self._state,
                ("GET", "frame"): lambda asked: json_answer(self._frame(self._number(asked, "frame", "frames"))),
                ("GET", "picture"): self._picture,
                ("GET", "line"): self._line,
                ("POST", "set"): self._set,
                ("POST", "person"): self._person,
                ("POST", "undo"): lambda _: self._back(self._editor.undo()),
                ("POST", "redo"): lambda _: self._back(self._editor.redo()),
                ("POST", "finish"): self._finish,
            },
            port,
        )

    @property
    def url(self) -> str:
        """Address of the page, for a browser on this machine."""
        return self._server.url

    @property
    def written(self) -> tuple[Path, ...]:
        """Files that were written."""
        return tuple(self._editor.written)

    def wait(self) -> None:
        """Return when the page's button Finish is pressed, or `stop` called."""
        while not self._ended.wait(0.2):
            pass

    def stop(self) -> None:
        """Serve the page no more. What was set is on disk already."""
        self._ended.set()
        self._server.stop()

    def _page(self, asked: Mapping[str, Any]) -> Answer:
        script, style = "\n".join(_asset(name) for name in _SCRIPTS), _asset("style.css")
        allowed = f"img-src 'self' data:; connect-src 'self'; style-src {_digest(style)}; script-src {_digest(script)}"
        page = Template(_asset("page.html")).substitute(
            title=html.escape(self._editor.capture.name), style=style, script=script
        )
        policy = f"default-src 'none'; {allowed}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        return Answer(page.encode(), "text/html; charset=utf-8", {"Content-Security-Policy": policy})

    def _state(self, asked: Mapping[str, Any]) -> Answer:
        capture = self._editor.capture
        views = [
            {"name": name, "size": list(size), "shown": name in self._shown, "numbers": own.tolist()}
            for name, size, own in zip(capture.camera_names, capture.recorded_sizes, capture.video_frames, strict=True)
        ]
        return json_answer(
            {
                "frames": list(self.frames),
                "num_frames": capture.num_frames,
                "views": views,
                "points": asked_points(),
                "bones": bones(),
                "calibrated": self._geometry is not None,
                "history": self._editor.history,
            }
        )

    def _frame(self, frame: int) -> dict[str, Any]:
        """Points of all views at a frame, and the lines on which the other views say that they lie."""
        cameras = range(self._editor.capture.num_cameras)
        points = [self._editor.points(camera, frame) for camera in cameras]
        lines = [
            {"from": camera, "point": int(index), **line}
            for camera in cameras
            for index in np.flatnonzero(points[camera][:, 2] > 0)
            for line in self._lines(camera, frame, points[camera][index, :2])
        ]
        people = [self._editor.num_people(camera, frame) for camera in cameras]
        views = [{"points": p.tolist(), "people": n} for p, n in zip(points, people, strict=True)]
        return {"frame": frame, "views": views, "lines": lines, "history": self._editor.history}

    def _lines(self, camera: int, frame: int, pixel: np.ndarray) -> list[dict[str, Any]]:
        if self._geometry is None:
            return []
        others = [other for other in range(self._editor.capture.num_cameras) if other != camera]
        found = [(other, self._geometry.line(frame, camera, other, pixel)) for other in others]
        return [{"to": other, "line": line.round(2).tolist()} for other, line in found if line is not None]

    def _picture(self, asked: Mapping[str, Any]) -> Answer:
        camera, frame = self._view(asked)
        return Answer(jpeg_bytes(self._pictures.image(camera, frame), _QUALITY), "image/jpeg")

    def _line(self, asked: Mapping[str, Any]) -> Answer:
        camera, frame = self._view(asked)
        return json_answer(self._lines(camera, frame, np.array(self._place(camera, [asked.get("x"), asked.get("y")]))))

    def _set(self, asked: Mapping[str, Any]) -> Answer:
        camera, frame = self._view(asked)
        point = self._number(asked, "point", "points")
        place = None if asked.get("place", 0) is None else self._place(camera, asked.get("place"))
        self._editor.set(camera, frame, point, place)
        return json_answer(self._frame(frame))

    def _person(self, asked: Mapping[str, Any]) -> Answer:
        camera, frame = self._view(asked)
        person, count = asked.get("person"), self._editor.num_people(camera, frame)
        if type(person) is not int or not 0 <= person < count:
            raise Refused(400, f"person must be a whole number from 0 to {count - 1}")
        self._editor.choose(camera, frame, person)
        return json_answer(self._frame(frame))

    def _back(self, change: Change | None) -> Answer:
        if change is None:
            raise Refused(409, "there is nothing more to undo or redo")
        moved = np.flatnonzero((change.before != change.after).any(1))
        point = next((p["index"] for p in asked_points() if p["index"] in moved), 0)
        return json_answer({"camera": change.camera, "point": point, **self._frame(change.frame)})

    def _finish(self, asked: Mapping[str, Any]) -> Answer:
        self._ended.set()
        return json_answer({"written": [path.name for path in self.written]})

    def _view(self, asked: Mapping[str, Any]) -> tuple[int, int]:
        return self._number(asked, "camera", "cameras"), self._number(asked, "frame", "frames")

    def _number(self, asked: Mapping[str, Any], name: str, plural: str) -> int:
        capture = self._editor.capture
        count = {"cameras": capture.num_cameras, "frames": capture.num_frames, "points": 25}[plural]
        value = asked.get(name)
        if type(value) is not int or not 0 <= value < count:
            raise Refused(400, f"{name} must be a whole number from 0 to {count - 1}")
        return value

    def _place(self, camera: int, place: Any) -> tuple[float, float]:
        """Read a place in the picture; refuse what is none."""
        width, height = self._editor.capture.recorded_sizes[camera]
        if not (isinstance(place, list) and len(place) == 2 and all(type(v) in (int, float) for v in place)):
            raise Refused(400, "a place is two numbers, x and y")
        x, y = place
        if not (0 <= x <= width and 0 <= y <= height):
            raise Refused(400, f"a place was given outside the picture, which has {width}x{height} pixels")
        return float(x), float(y)


def _frames_of(capture: Capture) -> tuple[int, ...]:
    """Frames to begin with, where nobody says."""
    if capture.selected_frames is not None:
        return capture.selected_frames
    detected = any(capture.keypoint_frames(camera) for camera in range(capture.num_cameras))
    if detected and capture.cameras_path is not None:
        return choose_frames(capture, capture.cameras).frames
    return tuple(dict.fromkeys((0, capture.num_frames // 2)))


def _asset(name: str) -> str:
    return (files("jaxmocap.annotation") / "assets" / name).read_text(encoding="utf-8")


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')}'"
