"""OpenCV's FileStorage as plain dicts: YAML, XML and JSON.

OpenCV itself reads none of it: on damaged files its parsers crash, by deep nesting or by trusting the sizes of a
matrix.
"""

import io
import json
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from typing import Any

import numpy as np

from jaxmocap._results import InputError

_DEEPEST = 12
_WORD = re.compile(r'"(?:[^"\\]|\\.)*"|[^\s"]+', re.DOTALL)
"""A string in quotes, in which a backslash makes the next sign literal, or what stands between blanks."""

_NO_NUMBERS = {".nan": np.nan, ".inf": np.inf, "-.inf": -np.inf}


def parse_xml(text: str, label: str) -> ElementTree.Element:
    """Parse an XML text and return its root.

    Raises `InputError` for a text that is malformed, nested too deeply or defines entities.
    """
    if "<!" in text.replace("<!--", ""):
        raise InputError(f"{label} has a DOCTYPE or entities, which are not read; expected plain XML: remove them")
    depth, root = 0, None
    try:
        for event, element in ElementTree.iterparse(io.StringIO(text), ("start", "end")):
            root = element if root is None else root
            depth += 1 if event == "start" else -1
            if depth > _DEEPEST:
                raise ElementTree.ParseError(f"it is nested more than {_DEEPEST} deep")
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{label} cannot be read: {error}; expected whole XML: export it again") from error
    assert root is not None
    return root


def _scalar(word: str) -> int | float | str:
    """Read a number, also as OpenCV writes those that are none, or a string."""
    for kind in (int, float):
        try:
            return kind(word)
        except ValueError:
            pass
    return _NO_NUMBERS.get(word.lower(), word)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Build a map, each key of which must be there once."""
    keys = [key for key, _ in pairs]
    if len(set(keys)) < len(keys):
        raise ValueError(f"it has {next(key for key in keys if keys.count(key) > 1)} twice")
    return dict(pairs)


def _from_element(element: ElementTree.Element) -> Any:
    """Read an element as a map, a sequence (members called `_`), or numbers and strings separated by blanks."""
    if len(element):
        if all(child.tag == "_" for child in element):
            return [_from_element(child) for child in element]
        return _once([(child.tag, _from_element(child)) for child in element])
    words = _WORD.findall(element.text or "")
    values = [re.sub(r"\\(.)", r"\1", word[1:-1]) if word[0] == '"' else _scalar(word) for word in words]
    return values[0] if len(values) == 1 else values


def _from_yaml(text: str) -> Any:
    """Read the events of a YAML text as plain values.

    No tag constructs anything; aliases, which could let a text grow, are refused.
    """
    import yaml

    def value(event: yaml.Event, depth: int = 0) -> Any:
        if depth > _DEEPEST:
            raise ValueError("it is nested too deeply")
        if isinstance(event, yaml.MappingStartEvent):
            pairs = []
            while not isinstance(key := next(events), yaml.MappingEndEvent):
                if not isinstance(key, yaml.ScalarEvent):
                    raise ValueError("it has a map with keys that are no names")
                pairs.append((key.value, value(next(events), depth + 1)))
            return _once(pairs)
        if isinstance(event, yaml.SequenceStartEvent):
            items = []
            while not isinstance(item := next(events), yaml.SequenceEndEvent):
                items.append(value(item, depth + 1))
            return items
        if not isinstance(event, yaml.ScalarEvent):
            raise ValueError("it has aliases, which are not read")
        return event.value if event.style else _scalar(event.value)

    header = re.match("%YAML.*", text)
    if header is None:
        raise ValueError("it does not begin with %YAML, as OpenCV's do")
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # in C where it was built, ten times as fast
    events: Iterator[Any] = yaml.parse(
        text[header.end() :], loader
    )  # without OpenCV's %YAML:1.0, which is no directive of YAML
    try:
        _, begin = next(events), next(events)
        return value(next(events)) if isinstance(begin, yaml.DocumentStartEvent) else None
    except yaml.YAMLError:
        raise ValueError("it is cut off or malformed") from None


def _matrices(value: Any) -> Any:
    """Turn maps with rows, cols and data into matrices, as lists of rows."""
    if isinstance(value, list):
        return [_matrices(item) for item in value]
    if not isinstance(value, dict):
        return value
    if not {"rows", "cols", "data"} <= value.keys():
        return {key: _matrices(item) for key, item in value.items()}
    height, width, data = value["rows"], value["cols"], value["data"]
    data = data if isinstance(data, list) else [data]
    if not (
        isinstance(height, int) and isinstance(width, int) and min(height, width) > 0 and height * width == len(data)
    ):
        raise ValueError(f"it has a matrix of {height} rows and {width} cols with {len(data)} numbers")
    return [data[row * width : (row + 1) * width] for row in range(height)]


def read_storage(text: str, label: str) -> dict[str, Any]:
    """Read a FileStorage: maps, lists, numbers, strings, and matrices as lists of rows.

    Raises `InputError` for a text that is not whole, and for XML that defines entities.
    """
    text = text.lstrip()
    try:
        if text.startswith("<"):
            found = _from_element(parse_xml(text, label))
        elif text.startswith("{"):
            found = json.loads(text, object_pairs_hook=_once)
        else:
            found = _from_yaml(text)
        found = _matrices(found)
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        reason = "it is nested too deeply" if isinstance(error, RecursionError) else error
        raise InputError(
            f"{label} cannot be read: {reason}; expected a whole FileStorage of OpenCV, in YAML, XML or JSON"
        ) from error
    if not isinstance(found, dict):
        raise InputError(f"{label} holds no cameras; expected a FileStorage of OpenCV with a section for each")
    return found
