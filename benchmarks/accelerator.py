"""What an accelerator computes and how long it takes: faces and scores against the CPU's, and what a tracked frame is.

    python benchmarks/accelerator.py ../shared/data/plaza --frames 0:12 --out accelerator.json

First a frame of the built-in capture: the share of pixels that show another face than on the CPU, and generations of
168 particles scored by Eq. 5 at every pixel. Then a capture is tracked, with the accuracy beside the times; JAX's
profiler watches two of the last frames: how many kernels they start, how many copies they make to and from the device,
and how long it works. These two frames take longer than the others for being watched. Ratios hold within one run only.
"""

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from functools import partial
from pathlib import Path

import jaxmocap

jaxmocap.configure()

import equinox as eqx  # noqa: E402
import jax  # noqa: E402
import numpy as np  # noqa: E402
from figures import Figure, add_options, finish, record  # noqa: E402
from scene import scene  # noqa: E402

from jaxmocap.character import Character, Pose, skin  # noqa: E402
from jaxmocap.energies import GroupProblem, body_part, prepare_base, score_particles, search_energy  # noqa: E402
from jaxmocap.metrics import evaluate  # noqa: E402
from jaxmocap.observation import FrameProblem  # noqa: E402
from jaxmocap.pipeline import track_capture  # noqa: E402
from jaxmocap.render import Driver, face_ids  # noqa: E402

PARTICLES = 168
CAPACITY = 8192
WATCHED = 2
"""Frames under the profiler."""

COMPILING = 4
"""Frames at the beginning that compile, and whose times do not count."""

LEAST_FRAMES = COMPILING + 2 + WATCHED


def drawn(device: jax.Device, character: Character, pose: Pose, problem: FrameProblem) -> np.ndarray:
    """Draw the faces of a frame on a device."""
    with jax.default_device(device):
        character, pose, problem = jax.device_put((character, pose, problem), device)
        views = (problem.intrinsics, problem.cam_from_world, problem.origins)
        return np.asarray(face_ids(skin(character, pose), character.faces, *views, *problem.size)[0])


def scored(
    device: jax.Device, group: GroupProblem, increments: np.ndarray, driver: Driver, repeats: int
) -> tuple[np.ndarray, float, float]:
    """Score a generation on a device: terms (particle, term), seconds of the first call, and of one after it."""
    with jax.default_device(device):
        energy, group, increments = jax.device_put((search_energy(), group, increments), device)
        score = eqx.filter_jit(partial(score_particles, driver=driver))
        begin = time.perf_counter()
        base = eqx.filter_jit(prepare_base)(energy, group, CAPACITY)
        found = jax.block_until_ready(score(energy, group, base, increments, CAPACITY))
        first, begin = time.perf_counter() - begin, time.perf_counter()
        for _ in range(repeats):
            found = score(energy, group, base, increments, CAPACITY)
        jax.block_until_ready(found)
        return np.asarray(found.terms), first, (time.perf_counter() - begin) / repeats


def against_cpu(device: jax.Device) -> list[Figure]:
    """Faces and scores of both, and the times of scores."""
    cpu = jax.local_devices(backend="cpu")[0]
    with jax.default_device(cpu):
        character, pose, problem = scene()
    ours, theirs = (drawn(where, character, pose, problem) for where in (device, cpu))
    covered = np.maximum(ours, theirs) >= 0
    figures = [record("pixels that show another face", 100 * (ours != theirs)[covered].mean(), "% of covered", 1.0)]
    for name in ("root", "l_arm"):
        dofs = list(character.skeleton.group(name))
        group = GroupProblem(character, body_part(character, tuple(dofs)), pose, problem)
        increments = np.zeros((PARTICLES, character.skeleton.num_dofs), np.float32)
        spread = np.where(np.array(dofs) < 3, 0.02, 0.05)
        increments[:, dofs] = np.random.default_rng(0).normal(0, spread, (PARTICLES, len(dofs)))
        terms, first, seconds = scored(device, group, increments, "scatter", 20)
        expected, _, on_cpu = scored(cpu, group, increments, "loop", 1)
        apart = np.abs(terms / expected - 1).max(0)
        figures += [
            record(f"a generation, {name}, first call", first, "s", 1.0),
            record(f"a generation, {name}", 1e3 * seconds, "ms", 0.3),
            record(f"particles per second, {name}", PARTICLES / seconds, "1/s", 0.3, "higher"),
            record(f"a generation, {name}, one core of the CPU / this", on_cpu / seconds, "", 0.5, "higher"),
            record(f"Eq. 6, {name}, largest difference", float(apart[0]), "of the energy", 1.0),
            record(f"Eq. 7, {name}, largest difference", float(apart[1]), "of the energy", 1.0),
        ]
    return figures


def watched(folder: str) -> list[Figure]:
    """Read off a profile what the device did, per frame."""
    kinds, busy, programs = Counter[str](), 0.0, Counter[str]()
    for file in Path(folder).rglob("*.xplane.pb"):
        for plane in jax.profiler.ProfileData.from_file(str(file)).planes:
            if not plane.name.startswith("/device:"):
                continue
            for line in plane.lines:
                for event in line.events if line.name.startswith("Stream") else ():
                    kind = event.name if event.name in ("MemcpyD2H", "MemcpyH2D") else "kernel"
                    kinds[kind] += 1
                    busy += 1e-9 * event.duration_ns
                    programs[str(dict(event.stats).get("hlo_module", kind))] += 1
    for program, count in programs.most_common(12):
        print(f"{count / WATCHED:10.0f} a frame  {program}", file=sys.stderr)
    return [
        record("kernels a frame", kinds["kernel"] / WATCHED, "", 0.2),
        record("copies to the host a frame", kinds["MemcpyD2H"] / WATCHED, "", 0.2),
        record("copies to the device a frame", kinds["MemcpyH2D"] / WATCHED, "", 0.2),
        record("the device works, a frame", busy / WATCHED, "s", 0.5),
    ]


def tracked(capture: Path, frames: tuple[int, int], quality: str, seed: int) -> list[Figure]:
    """Track a capture; times are means over the frames that neither compile nor are watched."""
    first, end = frames
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "result"

        def note(stage: str, done: int, _: int) -> None:
            if stage == "track" and done == end - first - 1 - WATCHED:
                jax.profiler.start_trace(folder)
            elif stage == "track" and done == end - first - 1:
                jax.profiler.stop_trace()

        motion = track_capture(
            capture, out, quality=quality, seed=seed, frames=frames, overlays=False, progress=note, cache=False
        )
        verdicts = json.loads((out / "report.json").read_text())["verdicts"]
        truth = motion.provenance.get("truth")
        scores = evaluate(out, truth) if truth else {}
        seen = watched(folder)
    seconds = [verdict["seconds"] for verdict in verdicts][COMPILING : -1 - WATCHED]
    figures = [
        record(f"seconds per frame, {stage}", float(np.mean([own.get(stage, 0) for own in seconds])), "s", 0.5)
        for stage in sorted({stage for own in seconds for stage in own})
    ]
    whole = float(np.mean([sum(own.values()) for own in seconds]))
    figures.append(record("seconds per frame, all stages", whole, "s", 0.5))
    for metric in ("marker_error_cm", "joint_error_cm"):
        if isinstance(scores.get(metric), dict):
            figures.append(record(metric, scores[metric]["mean"], "cm", 0.1))
    return figures + seen


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path, nargs="?", help="a capture folder; without one none is tracked")
    parser.add_argument("--frames", default="0:12", help=f"START:STOP, {LEAST_FRAMES} or more")
    parser.add_argument("--quality", default="normal", choices=("draft", "normal", "paper"))
    parser.add_argument("--seed", type=int, default=0)
    add_options(parser)
    options = parser.parse_args()
    device = jax.local_devices()[0]
    if device.platform == "cpu":
        print("JAX finds no accelerator here, only a CPU; install jax[cuda12] or the like.", file=sys.stderr)
        return 2
    figures = against_cpu(device)
    if options.capture:
        first, end = (int(number) for number in options.frames.split(":"))
        if end - first < LEAST_FRAMES:
            parser.error(f"--frames is {options.frames}; {LEAST_FRAMES} frames or more were expected.")
        figures += tracked(options.capture, (first, end), options.quality, options.seed)
    memory = (device.memory_stats() or {}).get("peak_bytes_in_use", 0)
    figures.append(record("most memory of the device", memory / 2**30, "GiB", 0.2))
    about = {"device": device.device_kind, "jax": jax.__version__, "quality": options.quality}
    return finish(figures, options, **about)


if __name__ == "__main__":
    sys.exit(main())
