"""`capture.toml`: reading it, holding it against the files that are there, and saying in sentences what is wrong."""

import difflib
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from jaxmocap._results import InputError
from jaxmocap.detection import LayoutName

FRAMES_LINE = re.compile(r"^[ \t]*frames\s*=.*$", re.MULTILINE)
_LONGEST_NAME, _LONGEST_PATH = 255, 2000  # bytes of a name, characters of a path
_LINE_NUMBER = re.compile(r"at line (\d+)")


@dataclass(frozen=True)
class Finding:
    """One thing noticed about a capture. An error makes it unusable, a warning may cost accuracy, a note is a fact."""

    severity: Literal["error", "warning", "note"]
    where: str
    message: str

    def __str__(self) -> str:
        return f"{self.severity}: {self.where}: {self.message}"


def _inside(path: str) -> str:
    pure = PurePosixPath(path.replace("\\", "/"))
    depth = 0
    for part in pure.parts:
        depth += -1 if part == ".." else 1
        if depth < 0:
            break
    if not path.strip() or pure.is_absolute() or re.match(r"[A-Za-z]:", path) or depth < 0 or "\0" in path:
        raise ValueError("is outside the capture folder; expected a relative path inside it")
    if any(len(part.encode()) > _LONGEST_NAME for part in pure.parts) or len(path) > _LONGEST_PATH:
        raise ValueError("is longer than the name of any file; expected a relative path inside the capture folder")
    return path


def _camera_name(name: str) -> str:
    if not re.fullmatch(r"[\w][\w.\- ]*", name):
        raise ValueError("is not a usable camera name, for it is part of file names; use letters, digits, - and _")
    return name


InsidePath = Annotated[str, AfterValidator(_inside)]
LONGEST_SIDE = 960
"""Pixels, of the pictures that are worked on; the paper's (Sec. 5)."""

_STRICT = ConfigDict(extra="forbid", strict=True, frozen=True)


class CameraEntry(BaseModel):
    """One `[[camera]]` of a capture.

    Attributes:
        name: part of file names; each camera needs its own.
        video: path in the capture folder.
        offset: seconds added to the video's own time to give the common time; by default 0, as if all started together.
    """

    model_config = _STRICT
    name: Annotated[str, AfterValidator(_camera_name)]
    video: InsidePath
    offset: FiniteFloat = 0.0


class CaptureConfig(BaseModel):
    """The content of `capture.toml`; paths are relative to the capture folder and stay inside it.

    Attributes:
        name: for reports; the folder's by default.
        fps: nominal frames per second; those of the first video by default.
        frames: how many of the shared frames to use; all by default.
        units: of the calibration's lengths.
        up: the world's vertical axis.
        actor: the character's file.
        cameras: COLMAP model folder or calibration file.
        selected_frames: numbers of frames in the first video (Gamma, paper Sec. 3); chosen by default.
        keypoints: folder of a detector's files.
        keypoint_layout: of the keypoint files; told by the number of points by default.
        masks: folder of PNG masks.
        truth: file of the true motion.
        longest_side: pixels of the pictures that are worked on; by default 960, the paper's (Sec. 5).
        camera: one section per video.
    """

    model_config = _STRICT
    name: str | None = None
    fps: Annotated[FiniteFloat, Field(gt=0)] | None = None
    frames: Annotated[int, Field(gt=0)] | None = None
    units: Literal["metres", "centimetres", "millimetres"] = "metres"
    up: Literal["x", "y", "z"] = "y"
    actor: InsidePath | None = None
    cameras: InsidePath | None = None
    selected_frames: list[int] | None = None
    keypoints: InsidePath | None = None
    keypoint_layout: LayoutName | None = None
    masks: InsidePath | None = None
    truth: InsidePath | None = None
    longest_side: Annotated[int, Field(ge=64, multiple_of=2)] = LONGEST_SIDE
    camera: Annotated[list[CameraEntry], Field(min_length=1)]


def config_path(path: str | Path) -> Path:
    """Find the configuration file of a capture given as its folder or as the file itself."""
    path = Path(path)
    file = path / "capture.toml" if path.is_dir() else path
    if path.is_file() and path.suffix.lower() != ".toml":
        raise InputError(
            f"{path} is no capture: a folder with a capture.toml, or that file itself, was expected. Of videos "
            "jaxmocap sync makes one (--out DIR), and jaxmocap run does everything"
        )
    if path.is_dir() and not file.exists() and (path / "motion.npz").exists():
        raise InputError(f"{path} holds a result; the capture that it was made of was expected")
    if not file.is_file():
        raise InputError(f"{file} does not exist; expected a capture folder with a capture.toml, or the file itself")
    return file


def _parse(file: Path) -> tuple[dict[str, Any], list[Finding]]:
    """TOML, forgiving exactly one thing: an unreadable `frames = ...`, since the videos hold the number."""
    try:
        text = file.read_text(encoding="utf-8-sig")
    except (UnicodeDecodeError, OSError) as error:
        raise InputError(f"{file} cannot be read as UTF-8 text: {error}") from error
    findings: list[Finding] = []
    while True:
        try:
            return tomllib.loads(text), findings
        except RecursionError:
            raise InputError(f"{file} is nested too deeply to be a capture's configuration") from None
        except tomllib.TOMLDecodeError as error:
            number = _LINE_NUMBER.search(str(error))
            line = int(number[1]) if number else len(text.splitlines())
            lines = text.splitlines()
            found = lines[line - 1].strip() if 0 < line <= len(lines) else ""
            if findings or not FRAMES_LINE.match(found):
                raise InputError(f"{file} line {line} is not valid TOML: {error}; found {found[:80]!r}") from error
            lines[line - 1] = ""
            text = "\n".join(lines)
            findings.append(
                Finding(
                    "warning",
                    f"{file.name} line {line}",
                    f"found {found[:80]!r}, which is not valid TOML; the line was ignored and the frames were taken "
                    "from the videos. Write a whole number, or remove the line",
                )
            )


def _sentence(file: Path, error: Any) -> str:
    location = ".".join(str(part) for part in error["loc"])
    key = str(error["loc"][-1])
    value = repr(error["input"])[:80]
    if error["type"] == "extra_forbidden":
        fields = CameraEntry.model_fields if len(error["loc"]) > 1 else CaptureConfig.model_fields
        near = difflib.get_close_matches(key, fields, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"expected one of {', '.join(fields)}"
        return f"{file}: unknown key {location!r}; {hint}"
    if error["type"] == "missing":
        return f"{file}: {location!r} is missing" + (
            "; expected one [[camera]] section per video, with name and video" if key == "camera" else ""
        )
    if error["type"] == "value_error":
        return f"{file}: {location} = {value} {error['ctx']['error']}"
    return f"{file}: {location} = {value} cannot be used: {error['msg'][0].lower()}{error['msg'][1:]}"


def _more_problems(file: Path, config: CaptureConfig) -> list[str]:
    problems = []
    for what in ("name", "video"):
        values = [getattr(camera, what) for camera in config.camera]
        for value in sorted({value for value in values if values.count(value) > 1}):
            problems.append(f"{file}: two cameras have the {what} {value!r}; each needs its own")
    if config.selected_frames is not None and not config.selected_frames:
        problems.append(f"{file}: selected_frames is empty; give frame numbers, or remove the line and they are chosen")
    return problems


def read_config(file: Path) -> tuple[CaptureConfig | None, list[Finding]]:
    """Read the configuration and report all findings; it is None if an error among them makes it unusable."""
    try:
        document, findings = _parse(file)
    except InputError as error:
        return None, [Finding("error", file.name, str(error))]
    try:
        config = CaptureConfig.model_validate(document)
    except ValidationError as error:
        return None, findings + [Finding("error", file.name, _sentence(file, item)) for item in error.errors()]
    problems = [Finding("error", file.name, problem) for problem in _more_problems(file, config)]
    return (None if problems else config), findings + problems


def missing_files(file: Path, config: CaptureConfig) -> list[tuple[str, str]]:
    """List files and folders the configuration names that do not exist: (key, sentence)."""
    found = []
    for key, is_folder in (("actor", False), ("cameras", None), ("keypoints", True), ("masks", True)):
        value = getattr(config, key)
        if value is None:
            continue
        path = file.parent / value
        if not (path.exists() if is_folder is None else path.is_dir() if is_folder else path.is_file()):
            what = "folder" if is_folder else "file"
            found.append(
                (key, f"{file}: {key} = {value!r} names a {what} that does not exist; correct or remove the line")
            )
    return found
