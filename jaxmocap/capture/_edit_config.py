"""Completing `capture.toml` in place: single values change; comments, order and layout stay."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.container import Container
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import AoT, InlineTable, Table

from jaxmocap._results import InputError

from ._config import FRAMES_LINE


def with_offsets(text: str, offsets: Sequence[float], file: Path) -> str:
    """Set `offset` of every camera, in seconds and in order, in the text of `capture.toml`.

    Raises `InputError` if the text is not TOML or does not have that many cameras.
    """
    document = _Document(text, file)
    cameras = document.toml.get("camera", ())
    if len(cameras) != len(offsets):
        raise InputError(
            f"{file} has {len(cameras)} cameras, and offsets were found for {len(offsets)}; was it changed meanwhile? "
            "synchronise again"
        )
    for camera, offset in zip(cameras, offsets, strict=True):
        document.set(camera, "offset", round(offset, 6) + 0.0)
    return document.text()


def with_cameras_line(text: str, cameras: str, file: Path) -> str:
    """Let `cameras` name this folder in the text of `capture.toml`. Raises `InputError` if the text is not TOML."""
    document = _Document(text, file)
    document.set(document.toml, "cameras", cameras)
    return document.text()


def with_keypoints_line(text: str, keypoints: str, file: Path) -> str:
    """Let `keypoints` name this folder in the text of `capture.toml`, whose files' layout is told by the number of
    points. Raises `InputError` if the text is not TOML."""
    document = _Document(text, file)
    document.set(document.toml, "keypoints", keypoints)
    document.toml.pop("keypoint_layout", None)
    return document.text()


def with_lines(text: str, values: Mapping[str, str | list[int] | None], file: Path) -> str:
    """Set these keys in the text of `capture.toml`, None taking one out. Raises `InputError` if it is not TOML."""
    document = _Document(text, file)
    for key, value in values.items():
        if value is None:
            document.toml.pop(key, None)
        else:
            document.set(document.toml, key, value)
    return document.text()


class _Document:
    """A TOML document that is edited; a `frames` line that is not valid, which opening forgives, is kept as it is."""

    def __init__(self, text: str, file: Path):
        self._mark = "\ufeff" if text.startswith("\ufeff") else ""
        self._ending = "\r\n" if "\r\n" in text else "\n"
        self._forgiven = ""
        text = text.removeprefix(self._mark)
        try:
            try:
                self.toml = tomlkit.parse(text)
            except TOMLKitError:
                found = FRAMES_LINE.search(text)
                if found is None:
                    raise
                self._forgiven = found[0]
                self.toml = tomlkit.parse(f"{text[: found.start()]}#{text[found.start() :]}")
        except TOMLKitError as error:
            raise InputError(f"{file} is not valid TOML: {error}; nothing was changed in it") from error

    def set(self, table: Any, key: str, value: float | str | list[int]) -> None:
        """Change a value, or add it behind the last one of its table: before comments and sections that follow."""
        if key in table or isinstance(table, InlineTable):
            table[key] = value
            return
        body = (table if isinstance(table, Container) else table.value).body
        keys = [number for number, (name, item) in enumerate(body) if name and not isinstance(item, AoT | Table)]
        item = tomlkit.item(value)
        item.trivia.trail = self._ending
        if keys:
            before = body[keys[-1]][1].trivia
            item.trivia.indent, before.trail = before.indent, before.trail or self._ending
        body.insert(keys[-1] + 1 if keys else 0, (tomlkit.key(key), item))

    def text(self) -> str:
        text = tomlkit.dumps(self.toml)
        return self._mark + text.replace(f"#{self._forgiven}", self._forgiven, bool(self._forgiven))
