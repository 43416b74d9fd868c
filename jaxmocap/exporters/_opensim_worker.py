"""OpenSim at work in a process of its own: it scales a model to a person and solves for the markers.

Run with the path of a job in JSON, in a folder of its own, where OpenSim leaves its log; results lie beside the job.
"""

import json
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import opensim

_POINTS = {
    "hip": (("Hip",), ("ASI",)),
    "knee": (("Knee",), ("KNE", "KNM"), ("KNE",)),
    "ankle": (("Ankle",), ("ANK", "MED"), ("ANK",)),
    "heel": (("Heel",), ("HEE",)),
    "toe": (("BigToe",), ("TOE",)),
    "shoulder": (("Shoulder",), ("SHO",)),
    "elbow": (("Elbow",), ("ELB", "ELM"), ("ELB",)),
    "wrist": (("Wrist",), ("WRA", "WRB"), ("WRA",)),
}
"""Markers without their side in whose middle an end of a bone is; the first ones that a model has count."""
_LIMBS = (("hip", "knee"), ("knee", "ankle"), ("heel", "toe"), ("shoulder", "elbow"), ("elbow", "wrist"))
_WIDTHS = (("RASI", "LASI"), ("RHip", "LHip"))


class Point(NamedTuple):
    """An end of a bone: where it is in the model and in our body, metres, and which body of the model carries it."""

    theirs: np.ndarray
    ours: np.ndarray
    carrier: str


class Measured:
    """Where a model's markers and joints are in its default pose; `ours` has our markers, standing."""

    def __init__(self, model: Any, names: dict[str, str], ours: dict[str, np.ndarray]) -> None:
        state = model.initSystem()
        model.realizePosition(state)
        self.points: dict[str, Point] = {}
        for name, own in names.items():
            marker = model.getMarkerSet().get(name)
            place = marker.getLocationInGround(state).to_numpy()
            self.points[own] = Point(place, ours[own], marker.getParentFrame().findBaseFrame().getName())
        self.parents, self.joints = {}, {}
        for index in range(model.getJointSet().getSize()):
            joint = model.getJointSet().get(index)
            child = joint.getChildFrame().findBaseFrame().getName()
            self.parents[child] = joint.getParentFrame().findBaseFrame().getName()
            self.joints[child] = joint.getChildFrame().getPositionInGround(state).to_numpy()

    def above(self, body: str) -> list[str]:
        """List a body and all it hangs from, up to the root."""
        path = [body]
        while self.parents.get(path[-1], "ground") != "ground":
            path.append(self.parents[path[-1]])
        return path

    def point(self, name: str, side: str) -> Point | None:
        """Find an end of a bone."""
        for choice in _POINTS[name]:
            found = [self.points[side + one] for one in choice if side + one in self.points]
            if len(found) == len(choice):
                theirs, ours = ([one.theirs for one in found], [one.ours for one in found])
                return Point(np.mean(theirs, axis=0), np.mean(ours, axis=0), found[0].carrier)
        return None

    def ends(self, first: str, last: str) -> list[tuple[Point, Point]]:
        """Find both ends of a bone on each side where they are known."""
        pairs = [(self.point(first, side), self.point(last, side)) for side in "LR"]
        return [(one, other) for one, other in pairs if one is not None and other is not None]


def factor(first: Point, last: Point) -> float:
    """Compare a distance in our body with that in the model."""
    return float(np.linalg.norm(first.ours - last.ours) / np.linalg.norm(first.theirs - last.theirs))


def scale_factors(at: Measured) -> dict[str, float]:
    """Measure by which factor each body must grow: along its own bone, or as the body next to it."""
    known: dict[str, float] = {}
    for first, last in _LIMBS:
        found = at.ends(first, last)
        for begin, end in found:
            ups = [at.above(begin.carrier), at.above(end.carrier)]
            path = [body for up in ups for body in up if not (body in ups[0] and body in ups[1])] or [end.carrier]
            nearest = min(path, key=lambda body: float(np.linalg.norm(at.joints[body] - begin.theirs)))
            known[nearest] = float(np.mean([factor(*pair) for pair in found]))
    root = at.above(next(iter(at.points.values())).carrier)[-1]
    widths = [factor(*(at.points[name] for name in pair)) for pair in _WIDTHS if set(pair) <= at.points.keys()]
    if widths:
        known[root] = widths[0]
    trunk, shoulders = at.ends("hip", "shoulder"), [at.point("shoulder", side) for side in "LR"]
    ups = [at.above(one.carrier) for one in shoulders if one is not None]
    if trunk and len(ups) == 2:
        for body in ups[0]:
            if body in ups[1] and body != root:
                known[body] = float(np.mean([factor(*pair) for pair in trunk]))
    factors = dict(known)
    for body in at.parents:
        if body not in known:
            children = [child for child, parent in at.parents.items() if parent == body and child in known]
            relatives = [*children, *(other for other in at.above(body) if other in known)]
            factors[body] = known[relatives[0]] if relatives else 1.0
    return factors


def tasks_into(tasks: Any, names: dict[str, str]) -> None:
    """Ask for every marker alike."""
    for name in names:
        task = opensim.IKMarkerTask()
        task.setName(name)
        task.setWeight(1.0)
        tasks.cloneAndAppend(task)


def run(job: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Scale, place the markers, solve; write model and motion into the folder and tell how far markers are off."""
    opensim.Logger.setLevelString("error")
    model = opensim.Model(job["model"])
    if job["markers"]:
        model.set_MarkerSet(opensim.MarkerSet(job["markers"]))
    state = model.initSystem()
    model.getMarkerSet()
    ours = {name: np.array(place) for name, place in job["standing"].items()}
    factors = scale_factors(Measured(model, job["names"], ours))
    scales = opensim.ScaleSet()
    for body, factor in factors.items():
        scale = opensim.Scale()
        scale.setSegmentName(body)
        scale.setScaleFactors(opensim.Vec3(factor))
        scale.setApply(True)
        scales.cloneAndAppend(scale)
    model.scale(state, scales, True, job["mass"])
    model.initSystem()
    placer = opensim.MarkerPlacer()
    placer.setStaticPoseFileName("standing.trc")
    span = opensim.ArrayDouble(0.0, 2)
    span.set(1, 1.0)
    placer.setTimeRange(span)
    placer.setMoveModelMarkers(True)
    tasks_into(placer.getIKTaskSet(), job["names"])
    placer.processModel(model, str(folder) + "/")
    model.setName(job["name"])
    model.printToXML(str(folder / "scaled.osim"))
    tool = opensim.InverseKinematicsTool()
    tool.setModel(model)
    tool.setMarkerDataFileName(str(folder / "moving.trc"))
    data = opensim.MarkerData(str(folder / "moving.trc"))
    tool.setStartTime(data.getStartFrameTime())
    tool.setEndTime(data.getLastFrameTime())
    tool.setResultsDir(str(folder))
    tool.setOutputMotionFileName(str(folder / "solved.mot"))
    opensim.PropertyHelper.setValueDouble(1e-7, tool.updPropertyByName("accuracy"))
    tasks_into(tool.getIKTaskSet(), job["names"])
    tool.run()
    errors = opensim.TimeSeriesTable(str(next(folder.glob("*ik_marker_errors.sto"))))
    return {
        "rms": errors.getDependentColumn("marker_error_RMS").to_numpy().tolist(),
        "worst": errors.getDependentColumn("marker_error_max").to_numpy().tolist(),
    }


if __name__ == "__main__":
    place = Path(sys.argv[1])
    done = run(json.loads(place.read_text()), place.parent)
    (place.parent / "done.json").write_text(json.dumps(done))
