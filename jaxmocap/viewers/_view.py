"""The viewer: a result in three dimensions in the browser, served by viser."""

import os
import socket
import threading
import time
from contextlib import suppress
from typing import Any

import numpy as np

from jaxmocap._results import InputError
from jaxmocap.capture import Capture
from jaxmocap.motion import Motion

from ._limb_trust import words_about
from ._shown import Shown, gather
from ._view_body import BodyView, SecondBody, TruePoints
from ._view_cameras import CameraViews
from ._view_curves import Curves

_FREE = "free"
_REST = 0.1  # seconds after which a slider that is dragged rests
_LEGEND = "Blue: found. Orange: doubtful. Red, see-through: lost or hidden. Click a camera to look through it."


def view(
    result: Motion | str | os.PathLike[str],
    *,
    other: Motion | str | os.PathLike[str] | None = None,
    truth: str | os.PathLike[str] | None = None,
    capture: Capture | str | os.PathLike[str] | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
) -> "ResultViewer":
    """Serve a result to the browser and return at once; the page is at `url` until `stop` is called.

    It shows the skinned mesh, the skeleton and the cameras with their images along a time line with the curves of
    energy and confidence, and lets one look through a camera. `other` is a second result of the same frames, shown
    over the first or beside it; `truth` and `capture` are those that the result was tracked with unless given. Only
    this machine reaches the page unless another `host` is given: whoever reaches it sees the images. Where `port` is
    taken the next free one is used. Raises `InputError` if viser is not installed or something given cannot be used.
    """
    try:
        import viser
    except ImportError:
        raise InputError("The viewer needs viser, which is not installed; run pip install 'jaxmocap[view]'.") from None
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        socket.create_server((host, 0), family=family).close()  # viser takes every refusal for a port in use
    except OSError as error:
        raise InputError(
            f"--host {host} is no address of this machine ({error.strerror or error}); 0.0.0.0 serves at all of them."
        ) from None
    shown = gather(result, other, truth, capture)
    return ResultViewer(viser.ViserServer(host=host, port=port, label="jaxmocap", verbose=False), shown)


class ResultViewer:
    """A page that `view` serves. `go` and `play` do what its slider and its button do."""

    def __init__(self, server: Any, shown: Shown):
        self._server, self.shown = server, shown
        self.position = -1
        self._lock, self._stopped = threading.RLock(), threading.Event()
        self._asked, self._rests = threading.Event(), threading.Event()
        self._build_scene()
        self._build_panel()
        self.go(0)
        server.on_client_connect(lambda client: self._cameras.welcome(client, self.position, self._view_index()))
        works = (self._play_along, self._follow, self._illustrate)
        self._threads = [threading.Thread(target=work, daemon=True) for work in works]
        for thread in self._threads:
            thread.start()

    @property
    def url(self) -> str:
        return f"http://{self._server.get_host()}:{self._server.get_port()}"

    @property
    def missing(self) -> tuple[str, ...]:
        """Sentences about what could not be shown."""
        return self.shown.missing

    def go(self, position: int) -> None:
        """Show one frame of the motion, by its position."""
        position = int(np.clip(position, 0, len(self.shown.motion) - 1))
        with self._lock:
            if position == self.position:
                return
            self._slider.value = position
            self.position = position
            self._redraw()

    def play(self, on: bool) -> None:
        """Play in the time of the video, over and over, or stop."""
        self._play.value = on

    def wait(self) -> None:
        """Return when the viewer was stopped, from elsewhere or by an interrupt."""
        with suppress(KeyboardInterrupt):
            self._stopped.wait()
        self.stop()

    def stop(self) -> None:
        """Close the page."""
        if not self._stopped.is_set():
            self._stopped.set()
            self._asked.set()
            self._rests.set()
            for thread in self._threads:
                thread.join(timeout=2)
            self._server.stop()

    # The scene ----------------------------------------------------------------------------------------------------

    def _build_scene(self) -> None:
        shown, scene = self.shown, self._server.scene
        motion = shown.motion
        scene.set_up_direction(f"+{motion.up}")
        axis = "xyz".index(motion.up)
        ground = np.zeros(3)
        ground[axis] = shown.ground
        scene.add_grid("/ground", plane=("yz", "xz", "xy")[axis], position=tuple(ground.tolist()), cell_size=0.5)
        self._body = BodyView(self._server, "/result/mesh", motion)
        self._bones = scene.add_line_segments("/result/skeleton", shown.bones(motion, 0), (20, 90, 40), thickness=0.014)
        self._other = None if shown.other is None else SecondBody(self._server, shown, shown.other)
        self._truth = None if shown.truth is None else TruePoints(self._server, shown.truth)
        self._cameras = CameraViews(self._server, shown, self._look_through)

    # The panel ----------------------------------------------------------------------------------------------------

    def _build_panel(self) -> None:
        shown, gui = self.shown, self._server.gui
        motion = shown.motion
        gui.configure_theme(dark_mode=False, show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()  # beside the scene, which it would cover
        self._says = gui.add_text("Frame", "", disabled=True)
        also = {"Violet: the second result.": shown.other, "Green: the truth.": shown.truth}
        known = (words for words, what in also.items() if what is not None)
        self._legend = gui.add_markdown(" ".join([_LEGEND, *known]))
        self._slider = gui.add_slider("Position", 0, max(len(motion) - 1, 1), 1, 0)
        self._play = gui.add_checkbox("Play", False)
        self._speed = gui.add_slider("Speed", 0.1, 2.0, 0.1, 1.0)
        self._slider.on_update(lambda _: self._asked.set())
        self._eye = gui.add_dropdown("Look through", (_FREE, *shown.camera_names), initial_value=_FREE)
        self._eye.on_update(lambda _: self._look())
        self._opacity = gui.add_slider("Overlay opacity", 0.0, 1.0, 0.05, 0.8)
        self._with_mesh = gui.add_checkbox("Mesh", True)
        self._with_bones = gui.add_checkbox("Skeleton", True)
        self._with_cameras = gui.add_checkbox("Cameras", True)
        self._with_images = gui.add_checkbox("Images", shown.capture is not None, disabled=shown.capture is None)
        self._with_truth = gui.add_checkbox("Truth", self._truth is not None, disabled=self._truth is None)
        absent = shown.other is None
        self._with_other = gui.add_checkbox("Second result", not absent, disabled=absent)
        self._beside = gui.add_checkbox("Side by side", False, disabled=absent)
        toggles = (self._opacity, self._with_mesh, self._with_bones, self._with_cameras, self._with_images)
        for toggle in (*toggles, self._with_truth, self._with_other, self._beside):
            toggle.on_update(lambda _: self._redraw())
        self._curves = Curves(self._server, motion)

    # What happens -------------------------------------------------------------------------------------------------

    def _redraw(self) -> None:
        with self._lock:
            self._draw_bodies()
            self._draw_rest()

    def _draw_bodies(self) -> None:
        """Draw what follows the slider at once: the bodies, and where the cameras are."""
        shown, motion, index = self.shown, self.shown.motion, self.position
        with self._server.atomic():
            self._says.value = f"{motion.frames[index]}, {motion.timestamps[index]:.2f} s, {words_about(motion, index)}"
            opacity = float(self._opacity.value)
            self._body.draw(index, opacity, self._with_mesh.value)
            self._bones.points = shown.bones(motion, index)
            self._bones.visible = self._with_bones.value
            if self._other is not None:
                bones = self._with_bones.value
                shows = (self._with_mesh.value and opacity > 0, bones) if self._with_other.value else (False, False)
                self._other.draw(index, opacity, *shows, self._beside.value)
            if self._truth is not None:
                self._truth.draw(index, self._with_truth.value)
            self._cameras.place(index, self._view_index(), self._with_cameras.value)
        self._server.flush()

    def _wanted_images(self) -> tuple[int, int | None, bool]:
        """Return the position, the camera that is looked through, and whether images are shown at all."""
        through = self._view_index()
        return self.position, through, self._with_images.value and (through is not None or self._with_cameras.value)

    def _draw_rest(self, images: dict[int, np.ndarray] | None = None) -> None:
        """Draw what takes longer: the images, read unless given, and the curves."""
        index, through, _ = wanted = self._wanted_images()
        images = self._cameras.read_images(*wanted) if images is None else images
        with self._server.atomic():
            self._cameras.show_images(index, through, images)
            self._curves.mark(index)
        self._server.flush()

    def _look(self) -> None:
        self._redraw()
        for client in self._server.get_clients().values():
            self._cameras.lead(client, self.position, self._view_index())

    def _look_through(self, camera: int) -> None:
        """Look through a camera that was clicked."""
        self._eye.value = self.shown.camera_names[camera]

    def _view_index(self) -> int | None:
        return None if self._eye.value == _FREE else self.shown.camera_names.index(self._eye.value)

    def _follow(self) -> None:
        """Draw the bodies where the slider is, always at the latest place."""
        late = False
        while not self._stopped.is_set():
            if not self._asked.wait(_REST if late else None):
                self._rests.set()
                late = False
                continue
            self._asked.clear()
            with self._lock:
                position = int(self._slider.value)
                if position != self.position and position < len(self.shown.motion):
                    self.position, late = position, True
                    self._draw_bodies()

    def _illustrate(self) -> None:
        """Draw images and curves where the slider rests; the bodies go on while the images are decoded."""
        while True:
            self._rests.wait()
            if self._stopped.is_set():
                return
            self._rests.clear()
            wanted = self._wanted_images()
            images = self._cameras.read_images(*wanted)
            with self._lock:
                if wanted == self._wanted_images():
                    self._draw_rest(images)

    def _play_along(self) -> None:
        times = self.shown.motion.timestamps
        while not self._stopped.wait(0.01):
            if not self._play.value or len(times) < 2:
                continue
            begin, here = time.perf_counter(), self.position
            after = (here + 1) % len(times)
            self.go(after)
            due = (times[after] - times[here] if after else 0.5) / float(self._speed.value)
            self._stopped.wait(max(due - (time.perf_counter() - begin), 0.001))
