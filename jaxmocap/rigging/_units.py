"""Units of files that do not name theirs."""

from jaxmocap._results import InputError

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048, "dm": 0.1}
ADULT, _ANYBODY = (1.3, 2.2), (0.3, 3.0)


def metres_per_unit(label: str, tall: float, height: float | None, units: str | None) -> tuple[float, str]:
    """The scale of a person who is `tall` in the file's units, and its name: from the `height` in metres, from `units`,
    or from what makes an adult. Raises `InputError` where none of that gives a person."""
    if height is not None:
        if not _ANYBODY[0] <= height <= _ANYBODY[1]:
            raise InputError(f"height is {height:g} m; {_ANYBODY[0]} to {_ANYBODY[1]} m was expected.")
        if units is not None:
            raise InputError("both a height and units are given; either of them fixes the scale.")
        return height / tall, "from the height"
    if units is not None:
        if units not in UNITS:
            raise InputError(f"units is {units!r}; one of {', '.join(UNITS)} was expected.")
        metres = tall * UNITS[units]
        if not _ANYBODY[0] <= metres <= _ANYBODY[1]:
            raise InputError(
                f"{label} is {metres:.4g} m tall in {units}; {_ANYBODY[0]} to {_ANYBODY[1]} m was expected."
            )
        return UNITS[units], units
    for name, factor in UNITS.items():
        if ADULT[0] <= factor * tall <= ADULT[1]:
            return factor, name
    if _ANYBODY[0] <= tall <= _ANYBODY[1]:
        return 1.0, "m"
    raise InputError(
        f"{label} is {tall:.4g} units tall, an adult in none of {', '.join(UNITS)}; give the height in metres "
        "(--height) or the units (--units)."
    )
