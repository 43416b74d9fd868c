"""How far a scan is from the surface it shows: the synthetic actor filmed from all around, and a real person.

    python benchmarks/scan.py [--views 8 20 40] [--cell 0.01] [--sway 0 1 3] [--walk] [--demo 8]
        [--standing ../shared/data/standing]

The synthetic actor stands still between the views of a shaky circle; distances go both ways between its surface and the
scan, joints are those that `rig` finds. `--walk` films the actor from a shaky circle and scans the video alone, told
the height: cameras and masks are found, and the scan is laid onto the truth by the cameras' places. `--sway`, in
centimetres at the head, makes the actor sway during a lap of half a minute; the truth is the mean pose. Of the real
person (`--standing`) no surface is known: every second mask, and all but eight, are left out and compared with the
scan's silhouette; so are the others' masks where ours are found. `--demo` films so many frames of the demo's dance and
tracks them with the scan from each number of views, with the true mesh, and with that mesh rigged anew. Every figure is
a small record as in `stages.py`; `--gate` compares with a committed file.
"""

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import jaxmocap

jaxmocap.configure()

import cv2  # noqa: E402
import numpy as np  # noqa: E402
import trimesh  # noqa: E402
from figures import Figure, add_options, finish, record  # noqa: E402
from scipy.spatial import KDTree  # noqa: E402

from jaxmocap._results import InputError  # noqa: E402
from jaxmocap.character import Character, Pose, skin  # noqa: E402
from jaxmocap.geometry import align_cameras, camera_residuals  # noqa: E402
from jaxmocap.metrics import evaluate  # noqa: E402
from jaxmocap.pipeline import track_capture  # noqa: E402
from jaxmocap.pipeline._scan_views import read_views  # noqa: E402
from jaxmocap.rigging import rig  # noqa: E402
from jaxmocap.scan import Scan, Views, overlaps, reconstruct  # noqa: E402
from jaxmocap.synthetic import (  # noqa: E402
    Outfit,
    Subject,
    develop,
    make_actor,
    make_capture,
    make_scene,
    render_view,
    stand,
    write_capture,
)
from jaxmocap.viewers import open_video  # noqa: E402

SIZE, FOCAL, AWAY, HEIGHT = (540, 960), 1100.0, 2.6, 1.3
STANDING_HEIGHT = 1.66
SHAKE, SAMPLES, LAP = 0.06, 200_000, 30.0
JOINTS = tuple(f"{side}_{joint}" for side in "lr" for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle"))


def circle(count: int, shake: np.ndarray) -> np.ndarray:
    """Camera poses on a circle around a person who stands at the origin, y up, shaken by `shake (count, 6)`."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    angles = 2 * np.pi * (np.arange(count) + 0.3) / count
    for pose, angle, shaken in zip(poses, angles, SHAKE * shake, strict=True):
        centre = np.array([AWAY * np.cos(angle), HEIGHT, AWAY * np.sin(angle)]) + shaken[:3]
        forward = np.array([0, 0.9, 0]) + shaken[3:] - centre
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        pose[:3, 3] = -pose[:3, :3] @ centre
    return poses


def swaying(actor: Character, count: int, sway: float, seed: int) -> np.ndarray:
    """Vertices of the actor who stands on the ground, at `count` moments of a lap; `sway` as in `stand`, metres."""
    vertices = np.asarray(actor.vertices, float)
    lift = np.array([0, -vertices[:, 1].min(), 0])
    if not sway:
        return np.tile(vertices + lift, (count, 1, 1))
    poses = stand(actor.skeleton, np.linspace(0, LAP, count), sway, seed)
    return lift + np.stack(
        [np.asarray(skin(actor, Pose(*pose)), float) for pose in zip(poses.root, poses.angles, strict=True)]
    )


def companion(away: float, seed: int) -> tuple[Subject, np.ndarray]:
    """Somebody taller in other clothes, who stands on the ground so many metres away from the origin, and vertices."""
    template, vertices = make_actor(), np.asarray(make_actor(1.86).vertices, float)
    outfit = Outfit.make(seed + 1000, "patterned", (2, 0, 1))
    subject = Subject(np.asarray(template.vertices, np.float32), np.asarray(template.faces), outfit)
    return subject, vertices + np.array([0.6 * away, -vertices[:, 1].min(), 0.8 * away])


def around(views: int, seed: int, sway: float = 0.0) -> Views:
    """Film the synthetic actor from so many views with true cameras and masks."""
    actor, rng = make_actor(), np.random.default_rng(seed)
    subject = Subject(np.asarray(actor.vertices, np.float32), np.asarray(actor.faces), Outfit.make(seed))
    scene, poses = make_scene(seed), circle(views, rng.standard_normal((views, 6)))
    intrinsics = np.array([[FOCAL, 0, SIZE[0] / 2], [0, FOCAL, SIZE[1] / 2], [0, 0, 1]])
    moved = swaying(actor, views, sway, seed)
    drawn = [render_view(scene, subject, *one, SIZE) for one in zip(moved, [intrinsics] * views, poses, strict=True)]
    grey = np.stack([cv2.cvtColor(develop(one.light, rng), cv2.COLOR_RGB2GRAY) for one in drawn])
    return Views(grey, np.stack([one.mask for one in drawn]), np.tile(intrinsics, (views, 1, 1)), poses)


def synthetic(views: int, seed: int, sway: float = 0.0, compensated: bool = False, cell: float = 0.01) -> list[Figure]:
    """Scan the synthetic actor from so many views, and measure; `compensated`: also with its sway looked for."""
    actor, seen = make_actor(), around(views, seed, sway)
    lift = np.array([0, -np.asarray(actor.vertices, float)[:, 1].min(), 0])
    begin = time.perf_counter()
    found = reconstruct(seen, cell=cell)
    seconds, scans = time.perf_counter() - begin, {"hull": reconstruct(seen, cell=cell, rounds=0), "scan": found}
    if compensated:
        scans["scan with sway"] = reconstruct(seen, cell=cell, swaying=True)
    label = f"synthetic, {views} views" + (f", sway {100 * sway:g} cm" if sway else "")
    label += f", grid of {1000 * cell:g} mm" if cell != 0.01 else ""
    figures = [record(f"{label}: seconds", seconds, "s", 0.5)]
    return [*figures, *scored(label, scans, actor, lift)]


def demo(views: int, frames: int, seed: int) -> list[Figure]:
    """Track the demo's dance with the true mesh, as it is and rigged anew, and with a scan from so many views; markers
    against the truth."""
    found, true, figures = reconstruct(around(views, seed)), make_actor(), []
    meshes = {"scan": (found.vertices, found.faces), "bare": (np.asarray(true.vertices, float), np.asarray(true.faces))}
    with tempfile.TemporaryDirectory() as place:
        folder = write_capture(make_capture(frames, seed=seed), Path(place) / "capture")
        rigged = {name: Path(place) / f"{name}.glb" for name in meshes}
        for name, mesh in meshes.items():
            rig(mesh, units="m", anew=True).character.save_glb(rigged[name])
        actors = {"the true mesh": None, "the true mesh rigged anew": rigged["bare"]}
        for name, actor in (actors | {f"the scan from {views} views": rigged["scan"]}).items():
            motion = track_capture(folder, Path(place) / name, seed=seed, actor=actor, overlays=False)
            error = evaluate(motion, folder / "truth.npz")["marker_error_cm"]["mean"]
            figures.append(record(f"demo, {frames} frames, {name}: markers, mean", error, "cm", 0.1))
    return figures


def walk(
    seed: int, sway: float = 0.0, uncompensated: bool = False, beside: float | None = None, frames: int = 160
) -> list[Figure]:
    """Film the synthetic actor once around, scan the video, and measure.

    `uncompensated`: also as if nobody swayed; somebody else stands `beside`, so many metres away.
    """
    actor, rng = make_actor(), np.random.default_rng(seed)
    vertices, faces = np.asarray(actor.vertices, float), np.asarray(actor.faces)
    lift = np.array([0, -vertices[:, 1].min(), 0])
    subject = Subject(np.asarray(actor.vertices, np.float32), faces, Outfit.make(seed))
    scene, shake = make_scene(seed), cv2.GaussianBlur(rng.standard_normal((frames, 6)), (1, 0), sigmaX=1, sigmaY=8)
    poses = circle(frames, shake / shake.std())
    intrinsics = np.array([[FOCAL, 0, SIZE[0] / 2], [0, FOCAL, SIZE[1] / 2], [0, 0, 1]])
    moved, others = swaying(actor, frames, sway, seed), [] if beside is None else [companion(beside, seed)]
    with tempfile.TemporaryDirectory() as place:
        video = Path(place) / "walk.mp4"
        with open_video(video, quality=18) as writer:
            for number, (body, pose) in enumerate(zip(moved, poses, strict=True)):
                drawn = render_view(scene, subject, body, intrinsics, pose, SIZE, bystanders=others)
                writer.write(number / 30, develop(drawn.light, rng))
        begin = time.perf_counter()
        shown = read_views(video, height=float(np.ptp(vertices[:, 1])), say=print)
    names, views = shown.names, shown.views
    scans = {"scan": reconstruct(views, swaying=True)}
    seconds, label = time.perf_counter() - begin, f"synthetic walk, {len(names)} views"
    label += (f", sway {100 * sway:g} cm" if sway else "") + (f", {beside:g} m from somebody" if beside else "")
    true = poses[[int(name.removeprefix("frame")) for name in names]]
    placed = align_cameras(views.cam_from_world, true)
    away, angle = camera_residuals(placed, views.cam_from_world, true)
    figures = [
        record(f"{label}: seconds", seconds, "s", 0.5),
        record(f"{label}: scale, true to found", placed.scale, "", 0.02),
        record(f"{label}: places of the cameras, mean", 100 * float(away.mean()), "cm", 0.2),
        record(f"{label}: directions of the cameras, mean", float(np.degrees(angle).mean()), "deg", 0.2),
    ]
    if scans["scan"].sway is not None:
        figures.append(record(f"{label}: sway found", 100 * scans["scan"].sway.extent, "cm", 0.2))
    if uncompensated:
        scans = {"scan without sway": reconstruct(views), **scans}
    laid = {name: replace(one, vertices=placed(one.vertices)) for name, one in scans.items()}
    return [*figures, *scored(label, laid, actor, lift)]


def scored(label: str, scans: dict[str, Scan], actor: Character, lift: np.ndarray) -> list[Figure]:
    """Distances between surfaces, and the joints that `rig` finds in the last of them."""
    vertices, faces, figures = np.asarray(actor.vertices, float), np.asarray(actor.faces), []
    for name, one in scans.items():
        both = apart(one, vertices + lift, faces)
        for way, distances in zip(("to the truth", "from the truth"), both, strict=True):
            figures.append(record(f"{label}: {name} {way}, mean", 1000 * float(distances.mean()), "mm", 0.1))
            figures.append(record(f"{label}: {name} {way}, p95", 1000 * float(np.quantile(distances, 0.95)), "mm", 0.1))
    found = list(scans.values())[-1]
    try:
        made = rig((found.vertices, found.faces), units="m", anew=True)
    except InputError as error:
        print(f"{label}: {error}", file=sys.stderr)
        return figures
    assert made.rest_from_file is not None
    file_from_rest, known = np.linalg.inv(made.rest_from_file), actor.skeleton
    places = np.stack([np.asarray(made.character.skeleton.landmark(joint), float) for joint in JOINTS])
    places = places @ file_from_rest[:3, :3].T + file_from_rest[:3, 3]
    truth = np.stack([np.asarray(known.landmark(joint), float) for joint in JOINTS]) + lift
    wrong = 100 * np.linalg.norm(places - truth, axis=1)
    return [*figures, record(f"{label}: joints after rigging, mean", float(wrong.mean()), "cm", 0.1)]


def apart(found: Scan, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances of the scan's surface from the true one, and of the true one from the scan's, metres."""
    meshes = (trimesh.Trimesh(*mesh, process=False) for mesh in ((found.vertices, found.faces), (vertices, faces)))
    ours, theirs = (np.asarray(trimesh.sample.sample_surface(mesh, SAMPLES, seed=0)[0]) for mesh in meshes)
    return KDTree(theirs).query(ours)[0], KDTree(ours).query(theirs)[0]


def standing(folder: Path) -> list[Figure]:
    """Scan the real person from a part of the views, and compare with the masks of the others."""
    figures, given = [], read_views(folder / "pictures", folder / "cameras", folder / "masks").views
    ours = read_views(folder / "pictures", folder / "cameras", height=STANDING_HEIGHT, say=print).views
    number = np.arange(len(given.masks))
    eight = np.isin(number, np.linspace(0, len(number), 8, endpoint=False).astype(int))
    for masks, views in (("", given), (" with masks that are found", ours)):
        for used in (number % 2 == 0, eight):
            found = reconstruct(views.only(used))
            overlap = 100 * overlaps(found.vertices, found.faces, views._replace(masks=given.masks).only(~used))
            label = f"real, {used.sum()} views{masks}: overlap with the masks left out"
            figures.append(record(f"{label}, mean", float(overlap.mean()), "%", 0.01, "higher"))
            figures.append(record(f"{label}, worst", float(overlap.min()), "%", 0.01, "higher"))
    begin = time.perf_counter()
    alone = read_views(folder / "pictures", height=STANDING_HEIGHT, say=print).views
    found, label = reconstruct(alone), "real, 20 pictures alone"
    figures.append(record(f"{label}: seconds", time.perf_counter() - begin, "s", 0.5))
    theirs = read_views(folder / "pictures", None, folder / "masks", STANDING_HEIGHT)  # these cameras, others' masks
    views = theirs.views
    placed = align_cameras(alone.cam_from_world, views.cam_from_world)(found.vertices)
    overlap = 100 * overlaps(placed, found.faces, views)
    figures.append(record(f"{label}: overlap with others' masks, mean", float(overlap.mean()), "%", 0.01, "higher"))
    return figures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, nargs="*", default=[8, 20, 40])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sway", type=float, nargs="*", default=[])
    parser.add_argument("--cell", type=float, nargs="*", default=[0.01], help="metres between the points of the grid")
    parser.add_argument("--walk", action="store_true")
    parser.add_argument("--demo", type=int, help="frames of the demo to track with the scans")
    parser.add_argument("--beside", type=float, help="metres from the actor of the walk to somebody else")
    parser.add_argument("--standing", type=Path)
    add_options(parser)
    options = parser.parse_args()
    cases = [(views, sway / 100) for views in options.views for sway in options.sway or [0.0]]
    figures = [
        figure
        for views, sway in cases
        for cell in options.cell
        for figure in synthetic(views, options.seed, sway, bool(options.sway), cell)
    ]
    if options.demo:
        figures += [figure for views in options.views for figure in demo(views, options.demo, options.seed)]
    if options.walk:
        figures += [
            figure
            for sway in options.sway or [0.0]
            for figure in walk(options.seed, sway / 100, bool(options.sway), options.beside)
        ]
    if options.standing:
        figures += standing(options.standing)
    return finish(figures, options, seed=options.seed)


if __name__ == "__main__":
    sys.exit(main())
