"""Any setting of a tracker by its name, for ablations and the command line: `search.retry.tries=5`."""

import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from inspect import isabstract
from typing import Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import jax.numpy as jnp
from jaxtyping import AbstractArray

from jaxmocap._results import InputError

Settings = TypeVar("Settings")

_SIZED = {
    "sampler.num_particles": "set search.particles",
    "sampler.num_iterations": "set search.iterations",
    "sampler.sigma_min": "the floors are 2 mm and 0.25 degrees",
}
"""Settings of a sampler that `SearchPlan.sized` replaces, and what to do."""


def with_settings(tracker: Settings, settings: Mapping[str, Any]) -> Settings:
    """Change some settings of a tracker.

    Names are the attributes from the tracker down, joined by dots. Any other record of settings can be changed the same
    way.

    An energy's terms are named by their name, as in `search_energy.terms.model_view.shading`, entries of other tuples
    by their number. Values may be text. "off" (or None) leaves an optional part out, "on" puts
    it in with its defaults. A part of which there are several, as the sampler, is chosen by the name of its class, and
    then has its defaults. Raises `InputError` for an unknown name or a value of another kind.
    """
    for name, value in settings.items():
        if name in _SIZED and getattr(tracker, "search", None) is not None:
            raise InputError(f"setting '{name}': the search sizes its sampler for every group; {_SIZED[name]}.")
        tracker = _changed(tracker, None, name.split("."), value, name)
    return tracker


def _changed(part: Any, kind: Any, path: list[str], value: Any, name: str) -> Any:
    """`part`, annotated as `kind`, with the setting at `path` below it changed."""
    if not path:
        return _converted(part, kind, value, name)
    head, rest = path[0], path[1:]
    if is_dataclass(part) or hasattr(part, "_fields"):
        record, is_tuple = cast(Any, part), hasattr(part, "_fields")
        known = list(record._fields) if is_tuple else [field.name for field in fields(record)]
        _expect(head, known, name)
        new = {head: _changed(getattr(record, head), get_type_hints(type(record))[head], rest, value, name)}
        return record._replace(**new) if is_tuple else replace(record, **new)
    if isinstance(part, tuple):
        known = [getattr(entry, "name", str(number)) for number, entry in enumerate(part)]
        _expect(head, known, name)
        index = known.index(head)
        return (*part[:index], _changed(part[index], type(part[index]), rest, value, name), *part[index + 1 :])
    what = "is off" if part is None else "has no parts"
    raise InputError(f"setting '{name}': what comes before '{head}' {what}; switch it on first or leave '{head}' out.")


def _expect(head: str, known: list[str], name: str) -> None:
    if head not in known:
        raise InputError(f"setting '{name}': there is no '{head}'; choose one of {', '.join(known)}.")


def _converted(part: Any, kind: Any, value: Any, name: str) -> Any:
    kinds = get_args(kind) if get_origin(kind) in (Union, types.UnionType) else (kind,)
    wanted = " or ".join(dict.fromkeys(_described(k) for k in kinds))
    if value is None or value == "off":
        if type(None) in kinds:
            return None
    elif value == "on":
        for k in kinds:
            if isinstance(k, type) and is_dataclass(k):
                return part if part is not None else k()
    else:
        for k in kinds:
            try:
                return _as_kind(k, value)
            except (ValueError, TypeError, OverflowError):
                continue
    raise InputError(f"setting '{name}' is {value!r}, but {wanted} was expected.")


def _as_kind(kind: Any, value: Any) -> Any:
    """Convert the value to this kind; raise when it is none."""
    if get_origin(kind) is Literal:
        if value in get_args(kind):
            return value
    elif kind is bool:
        if value in (True, False, "true", "false"):
            return value in (True, "true")
    elif kind is int:
        if float(value) == int(float(value)) >= 0 and not isinstance(value, bool):
            return int(float(value))
    elif kind is float:
        return _from_zero(float(value))
    elif kind is str:
        return str(value)
    elif isinstance(kind, type) and issubclass(kind, AbstractArray):
        value = float(value) if isinstance(value, str) else value
        return jnp.asarray(_from_zero(value) if isinstance(value, (int, float)) else value, jnp.float32)
    elif isinstance(kind, type) and isinstance(value, kind):
        return value
    elif isabstract(kind) and value in (known := _concrete(kind)):
        return known[value]()
    raise ValueError


def _concrete(kind: Any) -> dict[str, type]:
    """List the classes of an abstract part, by name."""
    return {one.__name__: one for one in kind.__subclasses__() if not isabstract(one)}


def _from_zero(value: float) -> float:
    """No setting means anything below 0, and what is no number would spoil the result silently."""
    if not value >= 0:
        raise ValueError
    return value


def _described(kind: Any) -> str:
    if kind is type(None):
        return "off"
    if get_origin(kind) is Literal:
        return " or ".join(map(str, get_args(kind)))
    if isinstance(kind, type) and issubclass(kind, AbstractArray):
        return "a number from 0"
    if isabstract(kind):
        return " or ".join(_concrete(kind))
    if is_dataclass(kind):
        return f"on (a {getattr(kind, '__name__', kind)})"
    return {int: "a whole number from 0", float: "a number from 0", bool: "true or false", str: "text"}.get(
        kind, str(kind)
    )
