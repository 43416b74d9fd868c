"""What is measured in videos, each at most once and when it is first asked for."""

from collections.abc import Callable, Sequence
from typing import Any

from .._video import VideoIndex
from ._brightness import Brightness, measure_brightness
from ._correlate_motion import compare_motions
from ._correlate_sound import compare_sounds
from ._estimate import Estimate, MethodName, Undecided
from ._flash import Flash, compare_flashes, find_flashes
from ._motion_curve import MotionCurve, measure_motion
from ._sound import Sound, read_sound

Progress = Callable[[str, int, int], None]


class Evidence:
    """Brightness, flashes, sound and motion of several videos, by camera number.

    Raises `Undecided` for what a video does not have, and `InputError` where one cannot be decoded.
    """

    def __init__(self, videos: Sequence[VideoIndex], progress: Progress | None = None):
        self.videos = tuple(videos)
        self._progress = progress
        self._kept: dict[tuple[str, int], Any] = {}

    def estimate(self, method: MethodName, first: int, second: int) -> Estimate:
        """What one method says about two videos."""
        if method == "sound":
            return compare_sounds(*self._both(self.sound, first, second))
        one, other = self._both(self.brightness, first, second)
        if method == "flash":
            return compare_flashes(one, other, self.flashes(first), self.flashes(second))
        return compare_motions(self.motion(first), self.motion(second))

    def brightness(self, camera: int) -> Brightness:
        def measure() -> Brightness:
            found = measure_brightness(self.videos[camera], self._tell("brightness", camera))
            if found.complaint is not None:
                raise Undecided(found.complaint)
            return found

        return self._once("brightness", camera, measure)

    def flashes(self, camera: int) -> list[Flash]:
        return self._once("flashes", camera, lambda: find_flashes(self.brightness(camera)))

    def sound(self, camera: int) -> Sound:
        return self._once("sound", camera, lambda: read_sound(self.videos[camera]))

    def motion(self, camera: int) -> MotionCurve:
        lit = [flash.frame for flash in self.flashes(camera)]
        tell = self._tell("motion", camera)
        return self._once("motion", camera, lambda: measure_motion(self.videos[camera], lit, tell))

    def _once(self, what: str, camera: int, measure: Callable[[], Any]) -> Any:
        key = (what, camera)
        if key not in self._kept:
            try:
                self._kept[key] = measure()
            except Undecided as undecided:
                self._kept[key] = undecided
        if isinstance(self._kept[key], Undecided):
            raise Undecided(str(self._kept[key]))
        return self._kept[key]

    def _both(self, of: Callable[[int], Any], first: int, second: int) -> tuple[Any, Any]:
        """Of two cameras; if neither has it, the reason names both."""
        missing = []
        for camera in (first, second):
            try:
                of(camera)
            except Undecided as undecided:
                missing.append(str(undecided))
        if missing:
            raise Undecided(" and ".join(missing))
        return of(first), of(second)

    def _tell(self, what: str, camera: int) -> Callable[[float], None]:
        """Progress in whole seconds of the video."""
        video, report = self.videos[camera], self._progress
        stage, total = f"{what} of {video.path.name}", int(video.seconds[-1])
        return lambda done: None if report is None else report(stage, int(done), total)
