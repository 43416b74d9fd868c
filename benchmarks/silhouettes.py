"""Are the silhouette baselines straw men? Each with true masks or its own, from true poses or its own.

    python benchmarks/silhouettes.py RUNS [--only sanity factors] [--stories fast-motion ...] [--cameras 2 ...]

"sanity" gives every baseline the true masks, and in every frame the true pose of the frame before: with five cameras
all around it must come under 3 cm. "factors" lets it find the masks itself, go on from its own last pose, begin where
optical flow leads, and see fewer cameras: two 90 degrees apart, three 120 and five 72, all of them around the person
("narrow-angle" therefore is the plain dance). The stories are those of the suite, 5 frames of 320 x 180 pixels, 15 per
second. "posecut-printed" has the publication's stick figure and optimiser. Every method knows the true pose and masks
of the first frame. RUNS holds the films and a file per run; a run that is there is not done again.
"""

import argparse
import json
import sys
import time
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import jaxmocap

jaxmocap.configure()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from figures import Figure, add_options, finish, record  # noqa: E402

from jaxmocap import InputError  # noqa: E402
from jaxmocap.baselines import Baseline, PoseCut, method  # noqa: E402
from jaxmocap.capture import Capture  # noqa: E402
from jaxmocap.character import Pose  # noqa: E402
from jaxmocap.experiments import STORIES, film, story  # noqa: E402
from jaxmocap.metrics import evaluate  # noqa: E402
from jaxmocap.motion import MotionHistory  # noqa: E402
from jaxmocap.observation import Observations, observe  # noqa: E402
from jaxmocap.pipeline import fit_capture_appearance, open_character  # noqa: E402
from jaxmocap.track import motion_of  # noqa: E402

NUM_FRAMES = 5
RIGS = {2: 90.0, 3: 120.0, 5: 72.0}  # cameras, and the degrees between neighbours
PRINTED = "posecut-printed"
METHODS = ("hasler-1", "hasler-5", "posecut", PRINTED)
CHOSEN = ("hasler-5", "posecut")
FEWER = ("arms-like-torso", "fast-motion")  # the stories of the factors
FACTORS = (("true", "true"), ("true", "own"), ("own", "true"), ("own", "own"), ("own", "own", "flow"))
BAR = 3.0  # cm: what a fair implementation reaches with five cameras and all that is true


class Case(NamedTuple):
    """A run: whose masks, and whose pose of the frame before, "true" or "own", and where it begins,
    as the publication says, "own", or where flow leads, "flow"."""

    story: str
    cameras: int
    method: str
    masks: str
    pose: str
    begin: str = "own"

    @property
    def name(self) -> str:
        return f"{self.story}-{self.cameras}-{self.method}-{self.masks}-masks-{self.pose}-pose-{self.begin}-start"


class Filmed(NamedTuple):
    """A capture as its methods see it, and its true poses."""

    observations: Observations
    poses: Pose

    def pose(self, frame: int) -> Pose:
        """Return the true pose of a frame."""
        return Pose(self.poses.root[frame], self.poses.angles[frame])


@lru_cache(maxsize=1)
def filmed(name: str, cameras: int, runs: Path) -> Filmed:
    """Film a story all around the person; masks are those of every frame, the selected frame is the first."""
    around = {"num_cameras": cameras, "view_angle_degrees": RIGS[cameras]}
    spec = story(name, quick=True).varied(num_frames=NUM_FRAMES, selected_frames=list(range(NUM_FRAMES)), **around)
    capture = Capture.open(film(spec, runs / "films")).with_selected_frames((0,))
    assert capture.truth is not None
    with np.load(capture.truth, allow_pickle=False) as truth:
        poses = Pose(jnp.asarray(truth["root"]), jnp.asarray(truth["angles"]))
    character, first = open_character(capture), {0: Pose(poses.root[0], poses.angles[0])}
    appearance = fit_capture_appearance(capture, capture.cameras, character, first, key=jax.random.key(0))
    return Filmed(observe(capture, capture.cameras, character, appearance, first), poses)


def tracked(film: Filmed, baseline: Baseline, own_pose: bool) -> tuple[list[float], float]:
    """Track a film; return the marker error of every frame after the first, centimetres, and the seconds of one.

    Frames from the one on in which the body leaves a picture have no error.
    """
    observations = film.observations
    worker = baseline.follow(observations, jax.random.key(0))
    shown = list(observations.frames(range(NUM_FRAMES)))
    step = worker.first(shown[0], film.pose(0))
    state, results, seconds = step.state, [step.result], []
    for picture in shown[1:]:
        if not own_pose:
            before = shown[picture.frame - 1]
            state = state._replace(history=MotionHistory(before.timestamp, film.pose(before.frame)))
        begin = time.perf_counter()
        try:
            step = worker.track(state, picture)
        except InputError as error:
            print(f"frame {picture.frame}: {error}", file=sys.stderr)
            break
        seconds.append(time.perf_counter() - begin)
        state = step.state
        results.append(step.result)
    scores = evaluate(motion_of(observations, results), observations.capture.truth)
    errors = scores["marker_error_per_frame_cm"][1:]
    return [*errors, *[float("nan")] * (NUM_FRAMES - 1 - len(errors))], float(np.median(seconds))


def done(case: Case, runs: Path) -> dict:
    """Do a run, or read what it left."""
    path = runs / f"{case.name}.json"
    if not path.is_file():
        film = filmed(case.story, case.cameras, runs)
        printed = case.method == PRINTED
        baseline = PoseCut(figure="sticks", outer="powell", pixels=1800) if printed else method(case.method)
        assert isinstance(baseline, Baseline)
        masks = film.observations.capture.mask if case.masks == "true" else None
        baseline = replace(baseline, masks=masks, begin=case.begin)
        errors, seconds = tracked(film, baseline, case.pose == "own")
        path.write_text(json.dumps({**case._asdict(), "errors": errors, "seconds": seconds}) + "\n")
        print(f"{case.name}: {np.round(errors, 2)} cm, {seconds:.1f} s per frame", file=sys.stderr, flush=True)
    return json.loads(path.read_text())


def listed(only: list[str], stories: list[str], rigs: list[int], methods: list[str]) -> list[Case]:
    """List the runs: films one after the other, so that each is prepared once."""
    films = [(name, max(RIGS)) for name in stories if max(RIGS) in rigs]
    cases = [Case(*film, one, "true", "true") for film in films for one in methods if "sanity" in only]
    if "factors" in only:
        films = [(name, cameras) for name in stories if name in FEWER for cameras in rigs]
        cases += [Case(*film, one, *factor) for film in films for factor in FACTORS for one in methods]
    return list(dict.fromkeys(cases))


def figures_of(rows: list[dict]) -> list[Figure]:
    """Make the records of runs: mean and worst frame."""
    figures = []
    for row in rows:
        name = "{story}, {cameras} cameras, {method}, {masks} masks, {pose} last pose, {begin} start".format(**row)
        figures.append(record(f"{name}: mean", float(np.mean(row["errors"])), "cm", 0.2))
        figures.append(record(f"{name}: worst frame", float(np.max(row["errors"])), "cm", 0.3))
    return figures


def table(rows: list[dict]) -> str:
    """Tabulate the mean errors: a line per method, masks, last pose, start and cameras, a column per story."""
    stories = list(dict.fromkeys(row["story"] for row in rows))
    head = f"| method | masks | last pose | start | cameras | {' | '.join(stories)} |"
    lines = [head, "|---" * (5 + len(stories)) + "|"]
    parts = ("method", "masks", "pose", "begin", "cameras", "story")
    cells = {tuple(row[part] for part in parts): float(np.mean(row["errors"])) for row in rows}
    order = lambda key: (key[0], key[1] != "true", key[2] != "true", key[3] != "own", key[4])  # noqa: E731
    for key in sorted({key[:-1] for key in cells}, key=order):
        found = [cells.get((*key, name)) for name in stories]
        shown = ["" if one is None else "failed" if np.isnan(one) else f"{one:.2f}" for one in found]
        lines.append(f"| {' | '.join(map(str, key))} | {' | '.join(shown)} |")
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path)
    parser.add_argument("--only", nargs="+", choices=("sanity", "factors"), default=["sanity", "factors"])
    parser.add_argument("--stories", nargs="+", choices=tuple(STORIES), default=list(STORIES))
    parser.add_argument("--cameras", nargs="+", type=int, choices=tuple(RIGS), default=list(RIGS))
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(CHOSEN))
    add_options(parser)
    options = parser.parse_args()
    options.runs.mkdir(parents=True, exist_ok=True)
    rows = [
        done(case, options.runs) for case in listed(options.only, options.stories, options.cameras, options.methods)
    ]
    print(table(rows))
    sane = [row for row in rows if row["cameras"] == max(RIGS) and row["masks"] == row["pose"] == "true"]
    beyond = [row for row in sane if not np.mean(row["errors"]) < BAR]
    print(f"{len(sane) - len(beyond)} of {len(sane)} sanity runs with {max(RIGS)} cameras are under {BAR} cm.")
    return finish(figures_of(rows), options)


if __name__ == "__main__":
    sys.exit(main())
