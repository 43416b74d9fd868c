"""What each of our settings brings: `normal` with one of them left out at a time, on a capture with truth.

    python benchmarks/ablation.py ../shared/data/plaza --frames 50:80 --seeds 0 1 [--only retry] [--out FIGURES.json]

Registration and appearance are those of the seed, made once. A row says how far markers and joints are off (joints are
those that rigs share), the acceleration of the joints, and the seconds that a frame takes, the first three left out,
which compile.
"""

import argparse
from pathlib import Path

import jaxmocap

jaxmocap.configure()

import jax  # noqa: E402
import numpy as np  # noqa: E402
from figures import Figure, add_options, finish, record  # noqa: E402

from jaxmocap.capture import Capture  # noqa: E402
from jaxmocap.metrics import evaluate  # noqa: E402
from jaxmocap.observation import Observations, observe  # noqa: E402
from jaxmocap.pipeline import character_of, register_and_learn, with_selected_frames  # noqa: E402
from jaxmocap.registration import masks_of  # noqa: E402
from jaxmocap.track import Tracker, track_frames, with_settings  # noqa: E402
from jaxmocap.track._sequence import motion_of  # noqa: E402

LEFT_OUT = {
    "nothing": {},
    "gating": {"search.gating": "off"},
    "retry": {"search.retry": "off"},
    "backward search": {"backward_search": "off"},
    "wide particles": {"search.wide": "0"},
    "small trunk": {"search.trunk": "1"},
    "prediction": {"prediction": "false"},
    "angles away from limits": {"angles": "same"},
    "posture": {"search_energy.terms.posture.weight": "0"},
    "search prior": {"search.prior": "0"},
    "surface rows": {"refine.surface_flow": "false"},
    "robust start": {"refine.robust_start": "1"},
    "short reach": {"refine.contours.reach": "15"},
    "few faces": {"search.faces": "1"},
    "clip": {"clip": "off"},
    "flow of the clip": {"clip.flow": "false"},
}
"""What is left out, and the settings that do it."""

SCORES = (
    ("markers", "marker_error_cm", "mean", "cm"),
    ("markers, worst frame", "marker_error_cm", "max", "cm"),
    ("joints", "joint_error_cm", "mean", "cm"),
    ("joints, 95th percentile", "joint_error_cm", "p95", "cm"),
    ("joints, worst", "joint_error_cm", "max", "cm"),
    ("acceleration error", "acceleration_error_m_per_s2", None, "m/s^2"),
)


def observed(capture: Capture, seed: int) -> Observations:
    """Register the selected frames and learn the appearance, as `track` does."""
    key = jax.random.key(seed)
    character = character_of(capture, None, None, key=jax.random.fold_in(key, 5)).character
    chosen, _ = with_selected_frames(capture, None, None)
    made = register_and_learn(chosen, character, key, None, "normal", True)
    chosen = chosen.with_masks(masks_of(made.masks))
    return observe(chosen, chosen.cameras, character, made.appearance, made.registrations)


def tracked(observations: Observations, name: str, seed: int, frames: tuple[int, int] | None) -> dict[str, float]:
    """Track with something left out and compare with the truth."""
    tracker = with_settings(Tracker.preset("normal"), LEFT_OUT[name])
    key = jax.random.fold_in(jax.random.key(seed), 3)
    results = track_frames(observations, tracker, key=key, frames=frames)
    motion = motion_of(observations, results, verdict=tracker.verdict, clip=tracker.clip)
    found = evaluate(motion, observations.capture.truth)
    scores = {
        label: float(found[of] if part is None else found[of][part]) for label, of, part, _ in SCORES if of in found
    }
    return scores | {"seconds per frame": float(np.mean([sum(result.seconds.values()) for result in results[3:]]))}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", type=Path)
    parser.add_argument("--frames", help="A:B")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--only", nargs="+", choices=list(LEFT_OUT), default=list(LEFT_OUT))
    add_options(parser)
    options = parser.parse_args()
    frames = None
    if options.frames:
        first, stop = map(int, options.frames.split(":"))
        frames = (first, stop)
    capture, figures = Capture.open(options.capture), list[Figure]()
    units = {label: unit for label, _, _, unit in SCORES} | {"seconds per frame": "s"}
    rows: dict[str, list[dict[str, float]]] = {name: [] for name in options.only}
    for seed in options.seeds:
        observations = observed(capture, seed)
        for name in options.only:
            rows[name].append(tracked(observations, name, seed, frames))
            print(
                f"seed {seed}, without {name}: " + ", ".join(f"{k} {v:.2f}" for k, v in rows[name][-1].items()),
                flush=True,
            )
    for name, found in rows.items():
        for label in found[0]:
            values = [scores[label] for scores in found]
            figures.append(record(f"without {name}: {label}", float(np.mean(values)), units[label], 0.2))
    return finish(figures, options, capture=capture.name, frames=options.frames or "all", seeds=options.seeds)


if __name__ == "__main__":
    raise SystemExit(main())
