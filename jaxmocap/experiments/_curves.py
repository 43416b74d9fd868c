"""Error curves over the frames as an SVG picture (Fig. 15b)."""

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

COLOURS = ("#0b6bcb", "#d1495b", "#2e8b57", "#e08e0b", "#7b52ab", "#00897b", "#8d6e63", "#546e7a")
_WIDTH, _HEIGHT, _LEFT, _BOTTOM, _TOP = 560, 240, 46, 34, 10


def error_curves(curves: Mapping[str, tuple[Sequence[int], Sequence[float]]], most: float | None = None) -> str:
    """An inline SVG: centimetres over frame numbers, a line per name. What is above `most` is cut off at the top."""
    points = {name: np.asarray(values, float) for name, (_, values) in curves.items()}
    frames = np.concatenate([np.asarray(numbers) for numbers, _ in curves.values()])
    first, last = float(frames.min()), float(max(frames.max(), frames.min() + 1))
    finite = np.concatenate([values[np.isfinite(values)] for values in points.values()])
    top = float(max(finite.max() if len(finite) else 1.0, 1.0)) if most is None else most
    step = _nice(top / 4)
    top = step * np.ceil(top / step)
    right = _WIDTH - 10

    def place(frame: float, value: float) -> tuple[float, float]:
        x = _LEFT + (right - _LEFT) * (frame - first) / (last - first)
        return x, _HEIGHT - _BOTTOM - (_HEIGHT - _BOTTOM - _TOP) * min(value, top) / top

    parts = [f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" xmlns="http://www.w3.org/2000/svg">']
    for value in np.arange(0, top + step / 2, step):
        y = place(first, value)[1]
        parts.append(f'<line x1="{_LEFT}" x2="{right}" y1="{y:.1f}" y2="{y:.1f}" class="grid"/>')
        parts.append(f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{value:g}</text>')
    for frame in np.unique(np.round(np.linspace(first, last, 6))):
        x = place(frame, 0)[0]
        parts.append(f'<text x="{x:.1f}" y="{_HEIGHT - _BOTTOM + 16}" text-anchor="middle">{frame:g}</text>')
    parts.append(f'<text x="{(_LEFT + right) / 2}" y="{_HEIGHT - 3}" text-anchor="middle">frame</text>')
    parts.append(f'<text transform="translate(12 {_HEIGHT / 2}) rotate(-90)" text-anchor="middle">cm</text>')
    for index, (name, (numbers, _)) in enumerate(curves.items()):
        known = [(n, v) for n, v in zip(numbers, points[name], strict=True) if np.isfinite(v)]
        line = " ".join("{:.1f},{:.1f}".format(*place(n, v)) for n, v in known)
        colour, width = COLOURS[index % len(COLOURS)], 3 if index == 0 else 1.6
        parts.append(
            f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="{width}">'
            f"<title>{escape(name)}</title></polyline>"
        )
    return "".join([*parts, "</svg>"])


def legend(names: Sequence[str]) -> str:
    """The lines' colours, as HTML."""
    entries = [
        f'<span><i style="background:{COLOURS[i % len(COLOURS)]}"></i>{escape(name)}</span>'
        for i, name in enumerate(names)
    ]
    return f'<p class="legend">{"".join(entries)}</p>'


def _nice(step: float) -> float:
    """The next 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(max(step, 1e-6)))
    return float(power * min(n for n in (1, 2, 5, 10) if n * power >= step * (1 - 1e-9)))
