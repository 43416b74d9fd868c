"""The report of an evaluation: one HTML page that needs nothing else, with error curves (Fig. 15b), and Markdown."""

import base64
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np

from jaxmocap._files import write_text
from jaxmocap.capture import Capture
from jaxmocap.motion import Motion
from jaxmocap.viewers import jpeg_bytes, overlay_frames

from ._sweep import MOTIONS
from ._tables import Row, Table, tables_of

_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;max-width:1100px;margin:2rem auto;padding:0 1rem;color:#1c2733}
h1{font-size:1.6rem} h2{font-size:1.2rem;margin-top:2.2rem} table{border-collapse:collapse;
margin:.6rem 0;font-size:14px}
caption{text-align:left;color:#51606f;padding-bottom:.3rem;white-space:nowrap}
 th,td{border-bottom:1px solid #d8dfe6;padding:.25rem .7rem;
text-align:right;white-space:nowrap} th:first-child,td:first-child{text-align:left} tr.ours td{font-weight:600}
.scroll{overflow-x:auto} svg{width:100%;max-width:560px;font:11px system-ui} svg .grid{stroke:#e3e8ed}
svg text{fill:#51606f}
.two{display:grid;grid-template-columns:repeat(auto-fit,minmax(420px,1fr));gap:1rem}
.legend span{margin-right:1.2rem} .legend i{display:inline-block;width:14px;height:4px;margin-right:.4rem;
vertical-align:middle} figure{margin:0} figcaption{font-size:13px;color:#51606f}
.side{display:flex;gap:.4rem;overflow-x:auto} .side img{height:220px} li{margin:.2rem 0}
"""
_PICTURED = 16
_COLOURS = (
    *("#0b6bcb", "#d1495b", "#2e8b57", "#e08e0b", "#7b52ab", "#00c2c7", "#8d6e63", "#546e7a", "#e377c2", "#9acd32"),
    *("#1a2a6c", "#7f1d1d", "#f4c20d", "#064e3b"),
)
_WIDTH, _HEIGHT, _LEFT, _BOTTOM, _TOP = 560, 240, 46, 34, 10


def write_report(
    rows: Sequence[Row], out: Path, captures: dict[str, Path], title: str = "Evaluation", notes: Sequence[str] = ()
) -> tuple[Path, Path]:
    """Write `report.html` and `report.md` into `out`. `captures` are the folders of those whose overlays are shown."""
    tables = tables_of(rows)
    failed = list({row["key"]: row for row in rows if row["status"] != "done"}.values())
    html, markdown = out / "report.html", out / "report.md"
    write_text(html, _html(rows, tables, failed, out, captures, title, notes))
    write_text(markdown, _markdown(tables, failed, title, notes))
    return html, markdown


def error_curves(curves: Mapping[str, tuple[Sequence[int], Sequence[float]]], most: float | None = None) -> str:
    """Draw centimetres over frame numbers, a line per name, as an inline SVG; what is above `most` lies on it."""
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
        colour, width = _COLOURS[index % len(_COLOURS)], 3 if index == 0 else 1.6
        parts.append(
            f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="{width}">'
            f"<title>{escape(name)}</title></polyline>"
        )
    return "".join([*parts, "</svg>"])


def _markdown(tables: Sequence[Table], failed: Sequence[Row], title: str, notes: Sequence[str]) -> str:
    parts = [f"# {title}", *notes]
    for table in tables:
        lines = [f"| {' | '.join(cells)} |" for cells in (table.head, *table.body)]
        rule = "|" + "---|" * len(table.head)
        parts += [f"**{table.caption}**", "\n".join([lines[0], rule, *lines[1:]])]
    if failed:
        parts += ["**Runs that failed**", "\n".join(f"- {row['key']}: {row.get('error')}" for row in failed)]
    return "\n\n".join(parts) + "\n"


def _html(
    rows: Sequence[Row],
    tables: Sequence[Table],
    failed: Sequence[Row],
    out: Path,
    captures: dict[str, Path],
    title: str,
    notes: Sequence[str],
) -> str:
    parts = [f"<h1>{escape(title)}</h1>", *(f"<p>{escape(note)}</p>" for note in notes)]
    compared = [row for row in rows if row["experiment"] == "comparison"]
    own = len(tables_of(compared))
    parts += [_table(table) for table in tables[:own]]
    if compared:
        parts += [_curves(compared), _overlays(compared, out, captures)]
    if tables[own:]:
        parts += ["<h2>One part or setting at a time</h2>", *(_table(table) for table in tables[own:])]
    if failed:
        items = "".join(f"<li>{escape(row['key'])}: {escape(str(row.get('error')))}</li>" for row in failed)
        parts.append(f"<h2>Runs that failed</h2><ul>{items}</ul>")
    parts.append(f"<h2>How this was made</h2>{_provenance(rows)}")
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><meta name="viewport" content="width=device-width">'
    return (
        f'<!doctype html><html lang="en"><head>{head}<style>{_STYLE}</style></head><body>{"".join(parts)}</body></html>'
    )


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(cell)}</th>" for cell in table.head)
    body = ""
    for line in table.body:
        cells = "".join(f"<td>{escape(cell)}</td>" for cell in line)
        body += f"<tr{' class=ours' if line[0] == 'ours' else ''}>{cells}</tr>"
    return (
        f'<div class="scroll"><table><caption>{escape(table.caption)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _curves(rows: Sequence[Row]) -> str:
    """Per capture the error of every method over the frames, of the first seed.

    The axis ends at three times what half of the methods stay below, lest one that lost the person flatten the others.
    """
    seed = min(row["seed"] for row in rows)
    methods = list(dict.fromkeys(row["value"] for row in rows))
    figures = []
    for capture in dict.fromkeys(row["capture"] for row in rows):
        members = {row["value"]: row for row in rows if row["capture"] == capture and row["seed"] == seed}
        curves = {}
        for method in methods:
            row = members.get(method, {})
            errors = row.get("error_per_frame_cm")
            known = [np.nan if error is None else error for error in errors or ()]
            curves[method] = (row["frame_numbers"], known) if errors else ([0], [np.nan])
        largest = [max(known) for _, values in curves.values() if (known := [v for v in values if np.isfinite(v)])]
        if largest:
            most = min(max(largest), 3 * float(np.median(largest)))
            figures.append(f"<figure>{error_curves(curves, most)}<figcaption>{escape(capture)}</figcaption></figure>")
    if not figures:
        return ""
    heading = f"<h2>Marker error over the frames (seed {seed}; what is larger than the axis lies on its end)</h2>"
    return f"{heading}{_legend(methods)}<div class='two'>{''.join(figures)}</div>"


def _legend(names: Sequence[str]) -> str:
    """Write the lines' colours, as HTML."""
    entries = [
        f'<span><i style="background:{_COLOURS[i % len(_COLOURS)]}"></i>{escape(name)}</span>'
        for i, name in enumerate(names)
    ]
    return f'<p class="legend">{"".join(entries)}</p>'


def _nice(step: float) -> float:
    """Round up to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(max(step, 1e-6)))
    return float(power * min(n for n in (1, 2, 5, 10) if n * power >= step * (1 - 1e-9)))


def _overlays(rows: Sequence[Row], out: Path, captures: dict[str, Path]) -> str:
    """Draw the last frame of every method side by side, as the first camera sees it, ours first."""
    seed, parts = min(row["seed"] for row in rows), []
    for name, folder in captures.items():
        members = [row for row in rows if row["capture"] == name and row["seed"] == seed and row["status"] == "done"]
        pictures = []
        for row in members[:_PICTURED]:
            picture, frame = _picture(folder, out / MOTIONS / row["key"])
            error = dict(zip(row["frame_numbers"], row.get("error_per_frame_cm") or (), strict=False)).get(frame)
            label = row["value"] if error is None else f"{row['value']}: {error:.1f} cm"
            data = base64.b64encode(picture).decode()
            pictures.append(
                f'<figure><img alt="{escape(label)}" src="data:image/jpeg;base64,{data}">'
                f"<figcaption>{escape(label)}</figcaption></figure>"
            )
        if pictures:
            parts.append(f'<h3>{escape(name)}</h3><div class="side">{"".join(pictures)}</div>')
    return f"<h2>The last frame</h2>{''.join(parts)}" if parts else ""


def _picture(folder: Path, result: Path) -> tuple[bytes, int]:
    """Draw the last frame of a result: a JPEG, and the frame's number."""
    capture, motion = Capture.open(folder), Motion.load(result)
    last = motion[np.array([len(motion) - 1])]
    [(_, image)] = overlay_frames(capture, capture.cameras, motion.character, last, 0)
    joints = np.asarray(last.joints[0], np.float64)
    view = capture.cameras.at(int(np.flatnonzero(capture.video_frames[0] == last.frames[0])[0]))
    local = joints @ np.asarray(view.cam_from_world[0, :3, :3]).T + np.asarray(view.cam_from_world[0, :3, 3])
    pixels = local @ np.asarray(view.intrinsics[0]).T
    pixels = pixels[:, :2] / pixels[:, 2:]
    height, width = image.shape[:2]
    room = 0.15 * np.ptp(pixels[:, 1])
    left, top = np.clip(pixels.min(0) - 2 * room, 0, [width - 2, height - 2]).astype(int)
    right, bottom = np.clip(pixels.max(0) + 2 * room, [left + 2, top + 2], [width, height]).astype(int)
    return jpeg_bytes(image[top:bottom, left:right]), int(last.frames[0])


def _provenance(rows: Sequence[Row]) -> str:
    done = [row for row in rows if row["status"] == "done"]
    if not done:
        return "<p>No run finished.</p>"
    runs = {row["key"]: row for row in done}.values()
    seconds, cpu = (sum(row[name] for row in runs) for name in ("seconds", "cpu_seconds"))
    versions = ", ".join(f"{name} {number}" for name, number in done[0]["versions"].items())
    hashes = ", ".join(sorted({f"{row['capture']} {row['capture_hash']}" for row in done}))
    return (
        f"<p>{len(runs)} runs, {seconds / 60:.0f} minutes ({cpu / 60:.0f} minutes of processor time) on "
        f"{escape(done[0]['device'])}.</p><p>{escape(versions)}</p><p>Captures: {escape(hashes)}</p>"
    )
