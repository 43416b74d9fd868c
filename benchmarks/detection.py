"""How near a model's keypoints come to true joints, and how many pictures it looks at in a second.

    python benchmarks/detection.py ../shared/data [--only plaza ...] [--models heavy full] [--out FIGURES.json]

The errors are those of the twelve joints of the limbs in pixels of the videos, over all pictures and cameras: against
the true joints seen through the true cameras, or, where the truth is a detector's, against what that wrote in
`keypoints_all` (points of confidence 0.3 or more). A detector's idea of a joint lies elsewhere than a joint's centre;
"less offset" takes the median of each joint's difference in each video out. Pictures per second are of the whole way,
decoding and finding the person included; seconds of processor time per picture are less disturbed by other programs.
Points that were given confidence 0 count too; "not believed" is their share.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from figures import Figure, add_options, finish, record

from jaxmocap.camera import project
from jaxmocap.capture import Capture, Detections, FrameReader
from jaxmocap.detection import BODY_25, CARDS, LAYOUTS, best_person, follow_person, get_weights, open_model
from jaxmocap.metrics import Truth

LIMBS = [f"{side}_{joint}" for side in "lr" for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")]
CAPTURES = ("plaza", "street", "balance")
SURE = 0.3


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--only", nargs="+", default=CAPTURES)
    parser.add_argument("--models", nargs="+", default=list(CARDS), choices=list(CARDS))
    parser.add_argument("--frames", type=int, default=100, help="of each capture, from the first")
    parser.add_argument("--weights", type=Path, help="folder, package or bundle; kept ones by default")
    add_options(parser)
    options = parser.parse_args()
    figures: list[Figure] = []
    for name in options.models:
        model = open_model(get_weights(name, options.weights, print))
        rows = [LAYOUTS[CARDS[name].layout].points.index(joint) for joint in LIMBS]
        for capture_name in options.only:
            capture = Capture.open(options.data / capture_name).as_recorded()
            stop = min(options.frames, capture.num_frames)
            differences, believed, pictures, seconds, work = [], [], 0, 0.0, 0.0
            for camera in range(capture.num_cameras):
                begin, before = time.perf_counter(), time.process_time()
                found = follow_person(recorded(capture, camera, stop), model)
                seconds, work = seconds + time.perf_counter() - begin, work + time.process_time() - before
                pictures += stop
                true = joints(capture, camera, stop)
                known = np.isfinite(true).all(-1) & found.found[:, None]
                difference = np.where(known[..., None], found.points[:, rows, :2] - true, np.nan)
                differences.append((difference, difference - np.nanmedian(difference, axis=0)))
                believed.append(found.points[:, rows, 2][known] > 0)
            title = f"{capture_name}, {name}: "
            for number, kind in enumerate(("", ", less offset")):
                errors = np.concatenate([np.linalg.norm(pair[number], axis=-1).ravel() for pair in differences])
                errors = errors[np.isfinite(errors)]
                figures.append(record(f"{title}median{kind}", float(np.median(errors)), "px", 0.1))
                figures.append(record(f"{title}90th percentile{kind}", float(np.percentile(errors, 90)), "px", 0.1))
            figures.append(record(f"{title}not believed", 1 - float(np.concatenate(believed).mean()), "", 1.0))
            figures.append(record(f"{title}pictures per second", pictures / seconds, "1/s", 0.5, "higher"))
            figures.append(record(f"{title}processor time per picture", work / pictures, "s", 0.5))
    return finish(figures, options)


def recorded(capture: Capture, camera: int, stop: int):
    """The pictures of the shared frames, as they are in the video."""
    reader = FrameReader(capture.indices[camera])
    for frame in range(stop):
        yield reader.read(int(capture.video_frames[camera, frame]))
    reader.close()


def joints(capture: Capture, camera: int, stop: int) -> np.ndarray:
    """Where the limbs' joints are in the pictures, (frame, joint, 2); NaN where not known."""
    folder = capture.folder / "keypoints_all"
    if folder.is_dir():
        detections = Detections.open(Capture.open(capture.folder, with_cameras=False), folder)  # not undistorted
        people = [best_person(detections.people(camera, frame)) for frame in range(stop)]
        points = np.stack([np.zeros((25, 3)) if one is None else one for one in people])
        points = points[:, [BODY_25.points.index(joint) for joint in LIMBS]]
        return np.where(points[..., 2:] >= SURE, points[..., :2], np.nan)
    truth = Truth.read(capture.truth)
    assert truth.joints is not None
    own = capture.video_frames[0, :stop]
    world = truth.joints[own][:, [truth.joint_names.index(joint) for joint in LIMBS]]
    cameras = capture.cameras
    assert not np.asarray(cameras.distortion).any()
    pixels, _ = project(cameras.intrinsics[camera], cameras.cam_from_world[camera, :stop], world)
    return np.asarray(pixels, float)


if __name__ == "__main__":
    raise SystemExit(main())
