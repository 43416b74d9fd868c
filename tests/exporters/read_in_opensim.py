"""Read dance.osim, dance.mot and dance.trc of a folder with OpenSim itself; write what it makes of them to read.npz."""

import sys
from pathlib import Path

import numpy as np
import opensim

MILES = {"pelvis_tx", "pelvis_ty", "pelvis_tz"}


def main(folder: Path) -> None:
    opensim.Logger.setLevelString("error")
    model = opensim.Model(str(folder / "dance.osim"))
    state = model.initSystem()
    coordinates = [model.getCoordinateSet().get(i) for i in range(model.getNumCoordinates())]
    names = [one.getName() for one in coordinates]
    bodies = [model.getBodySet().get(i) for i in range(model.getNumBodies())]
    joints = [model.getJointSet().get(i) for i in range(model.getJointSet().getSize())]
    markers = [model.getMarkerSet().get(i) for i in range(model.getNumMarkers())]
    motion = opensim.TimeSeriesTable(str(folder / "dance.mot"))
    labels, values = list(motion.getColumnLabels()), motion.getMatrix().to_numpy()
    found = {"coordinates": names, "columns": labels, "joint_names": [one.getName() for one in joints]}
    found |= {"marker_names": [one.getName() for one in markers], "body_names": [one.getName() for one in bodies]}
    found |= {"ranges": [(one.getRangeMin(), one.getRangeMax()) for one in coordinates]}
    found |= {"masses": [one.getMass() for one in bodies], "at": [], "marked": [], "bodies": []}
    for row in values:
        for name, value in zip(labels, row, strict=True):
            number = value if name in MILES else np.radians(value)
            coordinates[names.index(name)].setValue(state, number, False)
        model.realizePosition(state)
        found["at"].append([one.getChildFrame().getPositionInGround(state).to_numpy() for one in joints])
        found["marked"].append([one.getLocationInGround(state).to_numpy() for one in markers])
        found["bodies"].append([placed(one.getTransformInGround(state)) for one in bodies])
    found["solved"] = solved(folder, names)[:, [names.index(name) for name in labels]]
    np.savez(folder / "read.npz", values=values, **found)


def placed(transform) -> np.ndarray:
    """A transform as a matrix."""
    matrix = np.eye(4)
    matrix[:3, :3] = [[transform.R().get(i, j) for j in range(3)] for i in range(3)]
    matrix[:3, 3] = transform.p().to_numpy()
    return matrix


def solved(folder: Path, names: list[str]) -> np.ndarray:
    """What OpenSim's inverse kinematics finds by our settings, from beside other angles of the same shoulders."""
    model = opensim.Model(str(folder / "dance.osim"))
    rng = np.random.default_rng(0)
    for number in range(model.getNumCoordinates()):
        one = model.updCoordinateSet().get(number)
        start, name = one.getDefaultValue(), one.getName()
        if "shoulder" in name:
            start = -start if name.endswith("abd") else start - np.copysign(np.pi, start)
        one.setDefaultValue(start + rng.normal(0, np.radians(2)))
    model.initSystem()
    tool = opensim.InverseKinematicsTool(str(folder / "dance_ik.xml"))
    tool.setModel(model)
    tool.setMarkerDataFileName(str(folder / "dance.trc"))
    tool.setResultsDir(str(folder))
    tool.setOutputMotionFileName(str(folder / "solved.mot"))
    assert tool.run()
    table = opensim.TimeSeriesTable(str(folder / "solved.mot"))
    return table.getMatrix().to_numpy()[:, [list(table.getColumnLabels()).index(name) for name in names]]


main(Path(sys.argv[1]))
