"""`scan`: a walk around a standing person, or pictures from all around, become an actor."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from jaxmocap._files import atomic_path
from jaxmocap._results import InputError
from jaxmocap._types import Report, Say
from jaxmocap.registration import SegmentationSettings
from jaxmocap.rigging import RiggedMesh, refuse_number_of_triangles, rig
from jaxmocap.scan import Scan, reconstruct, vertex_colours

from ._scan_folder import ScanViews, is_views_folder
from ._scan_length import KnownLength, Pixel
from ._scan_views import read_views, widest_gap

POOR = 0.85
"""Overlap of the surface's silhouette and a mask below which somebody had better look at the mask."""

_LOOK = "look at it and correct it with --keep-views DIR"


@dataclass(frozen=True)
class ScannedActor:
    """An actor made of pictures.

    Attributes:
        scan: the surface in the cameras' world, in metres.
        rigged: the actor that was made of it.
        colours: of the actor's vertices, sRGB, for viewers.
        report: what was found, as JSON knows it: `views`, `left_out`, `widest_gap_degrees` around the person, what told
            the `scale` (`from` "height", "cameras", or "known length" and how well its marks agree), `overlap` and
            `masks` (where each comes from, and how sure it is) by view, `sway_cm` of somebody who was filmed and did
            not stand quite still, `scanned_triangles`, and what `rig` reports.
    """

    scan: Scan
    rigged: RiggedMesh
    colours: UInt8[np.ndarray, "vertex 3"]
    report: dict[str, Any]


def scan(
    pictures: str | Path,
    out: str | Path | None = None,
    *,
    cameras: str | Path | None = None,
    masks: str | Path | None = None,
    height: float | None = None,
    known_length: tuple[float, Mapping[str, tuple[Pixel, Pixel]]] | None = None,
    keep_views: str | Path | None = None,
    focal: float | None = None,
    weights: str | Path | None = None,
    num_faces: int = 5000,
    seed: int = 0,
    say: Say = lambda sentence: None,
    progress: Report = lambda stage, done, total: None,
) -> ScannedActor:
    """Scan a person who stands still, from a video once around or from pictures, and rig what comes out.

    `pictures` is a video of a walk around the person, of which sharp frames are taken; or a folder of JPEG or PNG files
    of one size, all taken at once or while the person stood still. `cameras` is a COLMAP model whose images have the
    names of these files, or a static calibration of cameras with the files' names; without it they are found by
    structure from motion of everything that the pictures show, all by one lens (`focal`, where it is known, in pixels
    of the pictures or of the video). `masks` is a folder of PNG files with the pictures' names, white on the person.
    Without masks the person is detected (extra `detect`) and cut out around the built-in body (`find_outlines`).

    `keep_views` is a new folder for what is looked at: `pictures` without distortion, `masks` and `overlays` of both,
    PNG files, and `views.json` with cameras and how sure each mask is. Given as `pictures`, masks corrected in any
    program, it is scanned again: nothing is looked for, and views whose pictures were deleted are left out.

    `weights` are the detector's networks, for a machine without a network.

    `height`, metres, tells the size. Instead `known_length` may: metres, and by name of the picture (without ending)
    the pixels of both ends, the same end first, in two or more `pictures` as they are stored, or as `keep_views` wrote
    them; it also replaces what told the scale of views that were kept. Neither is needed where masks and cameras in
    metres are given. Writes a GLB to `out`, if given, that `track --actor` takes, with a colour per vertex that exports
    keep. `say` takes sentences on what was assumed, `progress` what is being done. Raises `InputError` for files that
    are missing or do not fit, a walk that does not go around, marks of a length that do not agree, a person who moved,
    silhouettes with nothing in common, and where no standing person is found.
    """
    refuse_number_of_triangles(num_faces)
    if out is not None and Path(out).suffix.lower() != ".glb":
        raise InputError(f"{out}: a scan is written as GLB; choose a name that ends in .glb.")
    length = None if known_length is None else KnownLength(*known_length)
    told = {"focal": focal, "weights": weights, "seed": seed, "say": say, "progress": progress}
    shown = read_views(pictures, cameras, masks, height, length=length, keep_views=keep_views, **told)
    names, views, height = shown.names, shown.views, shown.height
    if doubtful := _doubtful(shown):
        place = keep_views or pictures
        how = f"correct {Path(place) / 'masks'} and scan {place}" if is_views_folder(Path(place)) else _LOOK
        say(f"The outline is doubtful in {', '.join(doubtful)}: {how}.")
    if length is not None and shown.length is not None:
        say(
            f"The known length tells the scale: its worst mark is off by {shown.length.off_pixels:.1f} pixels, and a "
            f"pixel of error in every mark is {shown.length.percent_per_pixel:.1f} % of the size."
        )
    progress("surface", 0, 1)
    found = reconstruct(views, swaying=shown.filmed)
    progress("surface", 1, 1)
    rigged = rig(
        (found.vertices, found.faces),
        num_faces=num_faces,
        height=height,
        units=None if height is not None else "m",
        anew=True,
        name=Path(out).stem if out is not None else "scan",
    )
    assert rigged.rest_from_file is not None  # a mesh without a skin
    back = np.linalg.inv(rigged.rest_from_file)
    rest = np.asarray(rigged.character.vertices, np.float64)
    confirmed = views._replace(sway=found.sway).only(found.used)
    colours = vertex_colours(rest @ back[:3, :3].T + back[:3, 3], np.asarray(rigged.character.faces), confirmed)
    left_out = [name for name, used in zip(names, found.used, strict=True) if not used]
    poor = [n for n, share in zip(names, found.overlap, strict=True) if share < POOR and n not in left_out]
    report = {
        "views": len(names),
        "left_out": left_out,
        "widest_gap_degrees": round(widest_gap(views.cam_from_world), 1),
        "scale": shown.scale,
        "overlap": {name: round(float(share), 4) for name, share in zip(names, found.overlap, strict=True)},
        "masks": dict(zip(names, shown.masks, strict=True)),
        "sway_cm": None if found.sway is None else round(100 * found.sway.extent, 2),
        "scanned_triangles": len(found.faces),
        **rigged.report,
    }
    if left_out:
        say(f"{', '.join(left_out)}: the mask lacks what the others show, and was left out; look at it.")
    if found.sway is not None:
        say(f"The person swayed by {report['sway_cm']:.1f} cm; the surface is that of the mean pose.")
    if poor:
        say(f"{', '.join(poor)}: the surface fits the mask badly; look at mask and camera.")
    if out is not None:
        with atomic_path(Path(out)) as temporary:
            rigged.character.save_glb(temporary, colours)
    return ScannedActor(found, rigged, colours, report)


def _doubtful(shown: ScanViews) -> list[str]:
    """List the views in which a mask that was found is not sure, and how sure it is."""
    sure = {name: one.get("confidence", 1.0) for name, one in zip(shown.names, shown.masks, strict=True)}
    return [f"{name} ({value:.2f})" for name, value in sure.items() if value < SegmentationSettings().warn_below]
