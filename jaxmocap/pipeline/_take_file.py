"""`takes.toml`: a list of takes, each with what is known of its person and cameras."""

import tomllib
from pathlib import Path, PurePath
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    FiniteFloat,
    ValidationError,
    model_validator,
)
from pydantic_core import PydanticCustomError

from jaxmocap._results import InputError
from jaxmocap._spans import read_span

_LONGEST, _LONGEST_NAME = 2000, 255  # characters of a path, bytes of a name
_OF_VIDEOS = ("camera_distance", "focal", "offset", "scan", "person", "keypoints", "static")
_EXPECTED = {
    "name": "the name of a folder, of letters, digits, spaces and the signs . _ -",
    "capture": 'a capture folder, such as "monday/walk"',
    "videos": 'a list of files, such as ["left.mp4", "right.mp4"]',
    "frames": 'frames A to B - 1 with 0 <= A < B, such as "10:40", "10:", ":40" or [10, 40]',
    "height": "metres, such as 1.8",
    "actor": 'a file, such as "ann.glb"',
    "camera_distance": "metres, such as 2.35",
    "focal": "pixels by camera, such as { left = 1480 }",
    "offset": "seconds to add to a camera's own time, such as { right = -0.4 }",
    "scan": 'a video or a folder of pictures, such as "walk_around.mp4"',
    "person": "a pixel by camera, such as { right = [430, 250] }",
    "keypoints": 'a folder, such as "keypoints"',
    "static": "true or false",
}
_LONGEST_SHOWN = 80  # characters of a value that cannot be used


def _path(text: str) -> str:
    longest = max((len(part.encode()) for part in PurePath(text).parts), default=0)
    if not text.strip() or "\0" in text or len(text) > _LONGEST or longest > _LONGEST_NAME:
        raise ValueError("is no path of a file or folder")
    return text


def _span(value: Any) -> tuple[int, int | None]:
    found = read_span(value) if isinstance(value, str) else None
    if isinstance(value, list) and [type(number) for number in value] == [int, int]:
        found = value[0], value[1]
    if found is None or found[0] < 0 or (found[1] is not None and found[1] <= found[0]):
        raise PydanticCustomError("span", "no span of frames")
    return found


_Path = Annotated[str, AfterValidator(_path)]


class TakeEntry(BaseModel):
    """One `[[take]]`: a capture, or videos; paths are relative to the file's folder.

    Attributes:
        name: of the folder of its result; by default the capture folder's.
        capture: a capture folder, tracked as `jaxmocap track` does.
        videos: of the same moment, of which a motion is made as `jaxmocap run` does.
        frames: (first, behind the last), None for the end; "A:B" or [A, B] in the file.
        height: of the person, metres.
        actor: the person's character or scan.
        camera_distance: of videos, as are those below and as `run` has them: metres between the first two cameras.
        focal: pixels, by camera.
        offset: seconds to add to a camera's own time, by camera.
        scan: a video once around the person, or a folder of pictures.
        person: pixel on the person in the first picture that all videos share, by camera.
        keypoints: folder of a detector's files.
        static: whether all cameras stand still.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
    name: Annotated[str, Field(pattern=r"^\w[\w.\- ]*$", max_length=100)] | None = None
    capture: _Path | None = None
    videos: Annotated[list[_Path], Field(min_length=1)] | None = None
    frames: Annotated[tuple[int, int | None], BeforeValidator(_span)] | None = None
    height: FiniteFloat | None = None
    actor: _Path | None = None
    camera_distance: FiniteFloat | None = None
    focal: dict[str, FiniteFloat] | None = None
    offset: dict[str, FiniteFloat] | None = None
    scan: _Path | None = None
    person: dict[str, Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)]] | None = None
    keypoints: _Path | None = None
    static: bool | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> "TakeEntry":
        if (self.capture is None) == (self.videos is None):
            raise ValueError('a take has either capture = "FOLDER" or videos = ["FILE", ...]')
        if self.videos is not None and self.name is None:
            raise ValueError("a take of videos needs a name")
        beside = [name for name in _OF_VIDEOS if getattr(self, name) is not None]
        if self.capture is not None and beside:
            raise ValueError(f"{beside[0]} is for takes of videos; a capture has its cameras and keypoints")
        return self

    def given(self, folder: Path, *names: str) -> dict[str, Any]:
        """Collect those of the values `names` that are given, paths as they are from `folder`."""
        found = {name: value for name in names if (value := getattr(self, name)) is not None}
        paths = ("actor", "scan", "keypoints")
        tuples = {"person": {camera: tuple(pixel) for camera, pixel in (self.person or {}).items()}}
        return {name: folder / value if name in paths else tuples.get(name, value) for name, value in found.items()}


class _TakeFile(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
    take: Annotated[list[TakeEntry], Field(min_length=1)]


def read_take_file(file: Path) -> list[TakeEntry]:
    """Read a list of takes. Raises `InputError` for a file that is no such list, naming the take."""
    try:
        return _TakeFile.model_validate(tomllib.loads(file.read_text(encoding="utf-8-sig"))).take
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{file} cannot be read as UTF-8 text: {error}") from error
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"{file} is not valid TOML: {error}") from error
    except ValidationError as error:
        raise InputError(_sentence(file, error.errors()[0])) from error


def _sentence(file: Path, error: Any) -> str:
    _, *where = error["loc"] or ("take",)
    number = f"take {where[0] + 1}" if where else "the list of takes"
    what = ".".join(str(part) for part in where[1:])
    if error["type"] == "extra_forbidden":
        known = ", ".join(TakeEntry.model_fields) if where else "take"
        return f"{file}: {number} has the unknown key {what or error['loc'][0]!r}; expected one of {known}"
    if error["type"] == "value_error":
        return f"{file}: {number}: {what + ' ' if what else ''}{error['ctx']['error']}"
    if error["type"] == "missing":
        return f"{file} lists no takes; expected a [[take]] section for each, with capture or videos"
    found = f"{what or 'take'} = {error['input']!r}"[:_LONGEST_SHOWN]
    expected = _EXPECTED[where[1]] if what else "a [[take]] section for each take"
    return f"{file}: {number}: {found} cannot be used; expected {expected}"
