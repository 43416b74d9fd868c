"""From how far away local descent finds home: soft Eq. 5, visible Gaussians and sums of Gaussians beside each other.

    python benchmarks/basins.py [--stories uniform-arm arms-like-torso] [--plot PICTURE.png] [--out FIGURES.json]

Small synthetic captures (`experiments.story`, quick) with the appearance learnt at the true poses. The root, the torso
and every limb are moved away from the truth of one frame along random directions, until the landmarks that the group
moves are off by 3, 6 or 12 cm in the mean (less where the joint limits end before). From there each energy is
followed downhill over the whole body by the same BFGS, without any prior. The hard Eq. 5, which the search scores, has
no gradient; it is given that of central differences, half a unit to both sides of every degree of freedom, of 2 cm, or
0.05 rad of the root, or 0.1 rad of a joint. A limb came back if its landmarks end within 1.5 cm of the truth in the
mean, and "halved" if they end at no more than half of where they began. The cosine is between the negative gradient
and the way home, over the group's own degrees of freedom, in the same units. Distances are to the truth: where an
energy has its minimum beside it, a start of less than that is led away; "from the truth" says how far.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jaxmocap

jaxmocap.configure()

import equinox as eqx  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from figures import Figure, add_options, finish, record  # noqa: E402
from scene import observed  # noqa: E402

from jaxmocap.baselines import SumsOfGaussians, gaussian_visibility  # noqa: E402
from jaxmocap.character import Pose, clamp, difference, landmark_positions, retract  # noqa: E402
from jaxmocap.energies import (  # noqa: E402
    GroupProblem,
    SearchEnergy,
    body_part,
    prepare_base,
    score_particles,
    soft_score,
)
from jaxmocap.experiments import story  # noqa: E402
from jaxmocap.observation import Frame, Observations  # noqa: E402
from jaxmocap.search import PolishPlan, downhill, fitted  # noqa: E402
from jaxmocap.synthetic import SyntheticCapture, make_capture  # noqa: E402
from jaxmocap.track import Tracker  # noqa: E402

AMOUNTS = (3.0, 6.0, 12.0)
"""Centimetres by which a group's landmarks are moved."""

HOME = 1.5
"""Centimetres within which a group has come back."""

TOLERANCE = 1e-4

STEEPER = {"sums": 30.0, "visibility": 10.0, "visibility-eq6": 10.0}
"""Factors of energies: BFGS takes its first step as long as the slope is steep."""


class Scene(NamedTuple):
    """One frame of a capture of which everything is known."""

    truth: SyntheticCapture
    observations: Observations
    frame: Frame
    pose: Pose


class Start(NamedTuple):
    """A pose with one group away from the truth, and by how much, centimetres."""

    group: str
    amount: float
    pose: Pose


class Trial(NamedTuple):
    """What came of one start: centimetres before and after, and the cosine of the slope with the way home."""

    energy: str
    group: str
    amount: float
    before: float
    after: float
    cosine: float


Energy = Callable[[Any, Pose], jax.Array]
"""Of arrays and a pose."""


def scene(name: str, number: int) -> Scene:
    """Film a quick story and observe one frame of it."""
    truth = make_capture(**dict(story(name, quick=True).arguments))
    return Scene(truth, *observed(truth, number), truth.pose(number))


def landmark_errors(scene: Scene, pose: Pose, group: str | None = None) -> float:
    """Mean distance of the landmarks that a group moves (default: all) from the truth, centimetres."""
    skeleton = scene.truth.character.skeleton
    gap = np.asarray(landmark_positions(skeleton, pose)) - np.asarray(landmark_positions(skeleton, scene.pose))
    moved = slice(None)
    if group is not None:
        moved = np.isin(np.asarray(skeleton.landmark_bodies), np.flatnonzero(skeleton.bodies_of(group)))
    return 100 * float(np.linalg.norm(gap, axis=1)[moved].mean())


def units(scene: Scene) -> np.ndarray:
    """What counts alike in every degree of freedom, as in `polish`."""
    unit = np.asarray(scene.truth.character.skeleton.per_dof(root=0.05, angles=0.1)).copy()
    unit[:3] = 0.02
    return unit


def starts(scene: Scene, directions: int, rng: np.random.Generator) -> list[Start]:
    """Move every group along random directions by each of the amounts."""
    skeleton, unit, found = scene.truth.character.skeleton, units(scene), []
    for group, dofs in skeleton.groups:
        for _ in range(directions):
            way = np.zeros(skeleton.num_dofs, np.float32)
            way[[*dofs]] = rng.normal(0, 1, len(dofs)) * unit[[*dofs]]
            for amount in AMOUNTS:
                length = 1.0
                for _ in range(10):
                    pose = clamp(skeleton, retract(skeleton, scene.pose, jnp.asarray(length * way, jnp.float32)))
                    length *= min(amount / max(landmark_errors(scene, pose, group), 1e-3), 2.0)
                found.append(Start(group, amount, pose))
    return found


def hard(unit: jax.Array, arrays: tuple[SearchEnergy, GroupProblem], pose: Pose) -> jax.Array:
    """Score the hard Eq. 5 of a pose, with the slope of central differences."""
    energy, group = arrays
    here = jax.tree.map(jax.lax.stop_gradient, pose)
    group, skeleton = replace(group, pose=here), group.character.skeleton
    capacity, beside = 2 ** (group.character.faces.shape[0] - 1).bit_length(), jnp.diag(0.5 * unit)
    steps = jnp.concatenate([jnp.zeros_like(unit)[None], beside, -beside])
    totals = score_particles(energy, group, prepare_base(energy, group, capacity), steps, capacity).total
    after, before = jnp.split(totals[1:], 2)
    return totals[0] + (after - before) / unit @ difference(skeleton, here, pose)  # adds nothing but its slope


def energies(scene: Scene, names: list[str]) -> dict[str, tuple[Energy, Any]]:
    """Make the energies of the scene, each a function of arrays and a pose, and its arrays."""
    character, problem, key = scene.truth.character, scene.frame.problem, jax.random.key(0)
    searched = Tracker.preset("normal").search_energy
    made: dict[str, tuple[Energy, Any]] = {}
    if "soft-eq5" in names:
        far = retract(character.skeleton, scene.pose, jnp.zeros(character.skeleton.num_dofs).at[2].set(-0.2))
        needed = jax.jit(lambda pose: soft_score(searched, character, pose, problem).needed)(far)
        settings = fitted(PolishPlan().soft, 1.5 * np.asarray(needed))

        def soft(arrays, pose):
            return soft_score(*arrays[:2], pose, arrays[2], settings).total

        made["soft-eq5"] = (soft, (searched, character, problem))
    if "hard-eq5" in names:
        part = body_part(character, character.skeleton.group("root"))
        group = GroupProblem(character, part, scene.pose, problem)
        made["hard-eq5"] = (partial(hard, jnp.asarray(units(scene), jnp.float32)), (searched, group))
    for name, cost in (("visibility", "distance"), ("visibility-eq6", "ratio")):
        if name in names:
            own = {"cost": cost, "step": 2, "uncovered_scale": 4.0}
            term = gaussian_visibility(character, scene.observations.surface, 300, **own)
            made[name] = (
                lambda arrays, pose: arrays[0].score_pose(arrays[1], pose, arrays[2]),
                (term, character.skeleton, problem),
            )
    if "sums" in names:
        baseline = SumsOfGaussians(acceleration=0.0)
        energy = baseline.energy(baseline.follow(scene.observations, key), scene.frame, scene.pose)
        still = jnp.zeros(character.skeleton.num_dofs)
        made["sums"] = (lambda arrays, pose: -eqx.tree_at(lambda e: e.pose, arrays, pose)(still), energy)
    return {name: made[name] for name in names}


def median_seconds(call: Callable[[], Any], times: int = 7) -> float:
    """Median time of a call that has been compiled."""
    jax.block_until_ready(call())
    spent = []
    for _ in range(times):
        begun = time.perf_counter()
        jax.block_until_ready(call())
        spent.append(time.perf_counter() - begun)
    return float(np.median(spent))


def examine(
    scene: Scene, name: str, energy: Energy, arrays: Any, begun: list[Start], steps: int, factor: float
) -> tuple[list[Trial], dict]:
    """Go downhill from every start; return the trials, and drift, steepness and seconds."""
    skeleton, unit = scene.truth.character.skeleton, units(scene)

    def along(delta, arrays, pose):
        return energy(arrays, clamp(skeleton, retract(skeleton, pose, delta)))

    @eqx.filter_jit
    def down(arrays, pose):
        return downhill(lambda moved: (factor * energy(arrays, moved), None), skeleton, pose, steps, TOLERANCE)[0]

    value, slope, still = eqx.filter_jit(along), eqx.filter_jit(jax.grad(along)), jnp.zeros(skeleton.num_dofs)
    about = {
        "value": median_seconds(partial(value, still, arrays, begun[0].pose)),
        "gradient": median_seconds(partial(slope, still, arrays, begun[0].pose)),
        "drift": landmark_errors(scene, down(arrays, scene.pose)),
    }
    trials, steep, clock = [], [], time.perf_counter()
    for start in begun:
        own = [*skeleton.group(start.group)]
        home = (np.asarray(difference(skeleton, start.pose, scene.pose)) / unit)[own]
        falling = -np.asarray(slope(still, arrays, start.pose)) * unit
        steep.append(factor * np.linalg.norm(falling))
        falling = falling[own]
        cosine = float(home @ falling / max(np.linalg.norm(home) * np.linalg.norm(falling), 1e-12))
        ends = [landmark_errors(scene, pose, start.group) for pose in (start.pose, down(arrays, start.pose))]
        trials.append(Trial(name, start.group, start.amount, *ends, cosine))
    about["steepness"] = float(np.median(steep))
    about["descent"] = (time.perf_counter() - clock) / len(begun)
    return trials, about


def summary(story_name: str, name: str, trials: list[Trial], about: dict) -> list[Figure]:
    """Make a record per amount, and those of speed."""
    label = f"{story_name} {name}"
    figures = [record(f"{label}: from the truth to", about["drift"], "cm", 0.3)]
    figures.append(record(f"{label}: steepness at the starts", about["steepness"], "per unit", 1.0))
    figures += [record(f"{label}: {what}", about[what], "s", 0.5) for what in ("value", "gradient", "descent")]
    for amount in sorted({trial.amount for trial in trials}):
        some = [trial for trial in trials if trial.amount == amount]
        back = np.mean([trial.after < HOME for trial in some])
        halved = np.mean([trial.after <= 0.5 * trial.before for trial in some])
        figures += [
            record(f"{label} {amount:g} cm: came back", float(back), "share", 0.3, "higher"),
            record(f"{label} {amount:g} cm: halved", float(halved), "share", 0.3, "higher"),
            record(f"{label} {amount:g} cm: ends at", float(np.median([t.after for t in some])), "cm", 0.3),
            record(f"{label} {amount:g} cm: cosine", float(np.median([t.cosine for t in some])), "", 0.3),
        ]
    return figures


def table(name: str, trials: list[Trial], about: dict) -> str:
    """Write a row of Markdown."""
    cells = []
    for amount in AMOUNTS:
        some = [trial for trial in trials if trial.amount == amount]
        ends, cosine = np.median([t.after for t in some]), np.median([t.cosine for t in some])
        back, halved = (sum(kept) for kept in ([t.after < HOME for t in some], [t.after <= t.before / 2 for t in some]))
        cells.append(f"{back}, {halved} of {len(some)}; {ends:.1f}; {cosine:.2f}")
    speed = f"{1000 * about['value']:.0f} / {1000 * about['gradient']:.0f}"
    return f"| {name} | {about['drift']:.1f} | {' | '.join(cells)} | {speed} | {about['descent']:.1f} |"


def plot(path: Path, trials: dict[str, list[Trial]]) -> None:
    """Draw where each start ended (dotted: where it began; grey: `HOME`), and the cosine; a column per story."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(2, len(trials), figsize=(5 * len(trials), 7), squeeze=False, sharey="row")
    places = np.arange(len(AMOUNTS))
    for column, (story_name, some) in enumerate(trials.items()):
        names = list(dict.fromkeys(trial.energy for trial in some))
        for number, name in enumerate(names):
            own = [trial for trial in some if trial.energy == name]
            beside = 0.15 * (number - (len(names) - 1) / 2)
            begun = np.array([AMOUNTS.index(trial.amount) for trial in own]) + beside
            axes[0, column].scatter(begun, [trial.after for trial in own], s=12, label=name)
            axes[1, column].scatter(begun, [trial.cosine for trial in own], s=12)
        axes[0, column].hlines(AMOUNTS, places - 0.35, places + 0.35, "k", "dotted", linewidth=1)
        axes[0, column].axhline(HOME, color="grey", linewidth=1)
        axes[0, column].set(yscale="log", title=story_name)
        for axis in axes[:, column]:
            axis.set_xticks(places, [f"{amount:g}" for amount in AMOUNTS])
        axes[1, column].set(xlabel="begun, cm")
    axes[0, 0].set_ylabel("ended, cm")
    axes[0, 0].yaxis.set_major_formatter("{x:g}")
    axes[1, 0].set_ylabel("cosine of slope and way home")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="upper center", ncol=4)
    figure.tight_layout(rect=(0, 0, 1, 0.96))
    figure.savefig(path, dpi=100)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stories", nargs="+", default=["uniform-arm", "arms-like-torso"])
    parser.add_argument("--energies", nargs="+", default=["sums", "visibility", "soft-eq5", "hard-eq5"])
    parser.add_argument("--frame", type=int, default=2)
    parser.add_argument("--directions", type=int, default=1, help="per group")
    parser.add_argument("--steps", type=int, default=60, help="of BFGS at most")
    parser.add_argument("--steeper", type=float, help="factor of every energy; default: as `STEEPER` says")
    parser.add_argument("--groups", nargs="+", help="default: all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--plot", type=Path, help="draw where every start ended into this file")
    add_options(parser)
    options = parser.parse_args()
    figures, every = [], {}
    for name in options.stories:
        filmed = scene(name, options.frame)
        begun = starts(filmed, options.directions, np.random.default_rng(options.seed))
        begun = [start for start in begun if options.groups is None or start.group in options.groups]
        print(
            f"\n| {name} | from truth, cm | {' | '.join(f'{a:g} cm' for a in AMOUNTS)} | ms | s per descent |",
            flush=True,
        )
        print("|" + "---|" * (len(AMOUNTS) + 4))
        every[name] = []
        for energy, (function, arrays) in energies(filmed, options.energies).items():
            factor = STEEPER.get(energy, 1.0) if options.steeper is None else options.steeper
            trials, about = examine(filmed, energy, function, arrays, begun, options.steps, factor)
            every[name] += trials
            print(table(energy, trials, about), flush=True)
            figures += summary(name, energy, trials, about)
    if options.plot:
        plot(options.plot, every)
    raw = {name: [trial._asdict() for trial in trials] for name, trials in every.items()}
    return finish(figures, options, frame=options.frame, seed=options.seed, steps=options.steps, trials=raw)


if __name__ == "__main__":
    raise SystemExit(main())
