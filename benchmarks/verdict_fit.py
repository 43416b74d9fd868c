"""Fit the verdict to one half of a corpus, and judge it by the other and by real captures.

    python benchmarks/verdict_fit.py CORPUS [--out FIGURES.json]

CORPUS is what `verdict_corpus.py` left. Both models of `jaxmocap/verdict/_model.py` are logistic regressions, every
film of a kind counting alike (`GOOD_FILMS`); limbs also learn from right ones that are turned away in a single frame.
The uncertainty's settings are those of greatest likelihood on good films. Printed are models and settings, to be copied
there; how well models that are fitted anew, and the library's with their logits stretched, do on films that were left
out; and, for each half and the real captures, how the verdict as it is in the library does: confusion of frames and
limbs by kind of film, predicted and found shares of wrong frames, how many such leaps are caught, and how often the
regions of the uncertainty hold.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jaxmocap

jaxmocap.configure()

import numpy as np  # noqa: E402
from figures import Figure, add_options, finish, record  # noqa: E402
from scipy.optimize import minimize  # noqa: E402
from scipy.special import gammaln  # noqa: E402
from scipy.stats import f  # noqa: E402
from verdict_corpus import Tracked, half_of, read_run  # noqa: E402

from jaxmocap.character import landmark_positions, with_limb  # noqa: E402
from jaxmocap.motion import TAILS  # noqa: E402
from jaxmocap.verdict import (  # noqa: E402
    SequenceVerdict,
    UncertaintySettings,
    VerdictSettings,
    joint_covariances,
    judge_sequence,
)
from jaxmocap.verdict._features import FRAME_FEATURES, LIMB_FEATURES, frame_features, limb_features  # noqa: E402
from jaxmocap.verdict._model import FRAME_MODEL, LIMB_MODEL, WRONG_FRAME, WRONG_LIMB, RiskModel, probability  # noqa: E402
from jaxmocap.verdict._outlier_camera import contradicted  # noqa: E402

FRAME_RIDGE, LIMB_RIDGE = 5e-3, 3e-4
"""Of the weights of standardised features; of frames there are few."""

LEAPS = 3
"""Moved limbs per good film."""

GOOD = (
    "good",
    "plaza",
    "street",
    *(f"{name}_{by}" for name in ("plaza", "street", "balance") for by in ("normal", "detections")),
)
"""Kinds of films with which nothing is wrong."""

GOOD_FILMS = 0.8
"""Share of people's films with which nothing is wrong: a corpus has more of the others, which count less each."""

SETTINGS = VerdictSettings()
_OUTER = {"arm": ("elbow", "wrist"), "leg": ("knee", "ankle")}


class Film(NamedTuple):
    """A corpus run's features, and which of its frames and limbs are wrong."""

    run: Tracked
    features: np.ndarray
    wrong: np.ndarray
    limbs_wrong: np.ndarray

    @classmethod
    def of(cls, run: Tracked) -> "Film":
        features = frame_features(run.results, ~contradicted(run.results, SETTINGS), SETTINGS)
        worst = []
        for name in run.character.skeleton.limb_labels.values():
            side, kind = name.split()
            columns = [run.joint_names.index(f"{side[0]}_{joint}") for joint in _OUTER[kind]]
            worst.append(np.nanmax(run.errors[:, columns], axis=1))
        frames = np.nanmean(run.errors, axis=1)
        return cls(run, features, frames > WRONG_FRAME, np.stack(worst, axis=1) > WRONG_LIMB)

    @property
    def kind(self) -> str:
        return self.run.name.split("_", 1)[1] if self.run.name[0].isdigit() else self.run.name


def shares(films: Sequence[Film]) -> np.ndarray:
    """How much each film counts: good ones make up `GOOD_FILMS`, whatever their number."""
    good = np.array([film.kind in GOOD for film in films])
    return np.where(good, GOOD_FILMS / max(good.sum(), 1), (1 - GOOD_FILMS) / max((~good).sum(), 1))


def per_frame(films: Sequence[Film]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Features, mistakes and weights of all frames of some films."""
    weights = [
        np.full(len(film.wrong), share / len(film.wrong)) for film, share in zip(films, shares(films), strict=True)
    ]
    features, wrong = (np.concatenate([getattr(film, name) for film in films]) for name in ("features", "wrong"))
    return features, wrong, np.concatenate(weights)


def leaping(film: Film, rng: np.random.Generator) -> tuple[Sequence, int, int] | None:
    """Move a right limb of one frame away: results, frame and limb."""
    run = film.run
    limb, frame = int(rng.integers(4)), int(rng.integers(2, max(len(run.results) - 2, 3)))
    if len(run.results) < 8 or film.limbs_wrong[frame, limb]:
        return None
    skeleton, results = run.character.skeleton, list(run.results)
    pose, dofs = results[frame].pose, skeleton.group(list(skeleton.limb_labels)[limb])
    other = results[int(rng.integers(len(results)))].pose
    size = rng.uniform(0.6, 1.2)
    moved = np.array(pose.angles)
    moved[[dof - 6 for dof in dofs[:3]]] += size * rng.choice([-1.0, 1.0], 3)
    away = with_limb(pose, replace(other, angles=moved.astype(np.float32)), dofs)
    results[frame] = replace(results[frame], pose=away)
    return results, frame, limb


def fitted(
    names: Sequence[str], features: np.ndarray, wrong: np.ndarray, weight: np.ndarray, ridge: float
) -> RiskModel:
    """Fit a logistic regression by its weighted likelihood; only the weights of "alone" and "wide apart" may be
    negative."""
    middle, spread = np.average(features, axis=0, weights=weight), features.std(axis=0) + 1e-9
    standard, weight = (features - middle) / spread, weight / weight.sum()

    def loss(values: np.ndarray) -> tuple[float, np.ndarray]:
        logit = values[0] + standard @ values[1:]
        slope = weight * (probability(logit) - wrong)
        cost = float((weight * (np.logaddexp(0, logit) - wrong * logit)).sum() + ridge / 2 * (values[1:] ** 2).sum())
        return cost, np.concatenate([[slope.sum()], standard.T @ slope + ridge * values[1:]])

    bounds = [(None, None)] + [(None if name in ("alone", "wide apart") else 0.0, None) for name in names]
    values = minimize(loss, np.zeros(len(names) + 1), jac=True, bounds=bounds, method="L-BFGS-B").x
    weights = values[1:] / spread
    usual = np.average(features[~wrong], axis=0, weights=weight[~wrong])
    rounded = [tuple(round(float(value), 3) for value in row) for row in (weights, usual)]
    return RiskModel(tuple(names), round(float(values[0] - weights @ middle), 3), *rounded)


def fit(films: Sequence[Film]) -> tuple[RiskModel, RiskModel]:
    """Fit the models of frames and of limbs."""
    model = fitted(FRAME_FEATURES, *per_frame(films), FRAME_RIDGE)
    return model, fitted(LIMB_FEATURES, *limb_samples(films, model), LIMB_RIDGE)


def limb_samples(films: Sequence[Film], model: RiskModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Features, mistakes and weights of limbs, and of right ones that are turned away; `model` is that of frames."""
    rng, rows, wrong, weight = np.random.default_rng(0), [], [], []
    for film, share in zip(films, shares(films), strict=True):
        logit = model.logit(film.features)
        found = limb_features(film.run.results, film.run.character.skeleton, logit)
        each = share / film.limbs_wrong.size
        rows.append(found.reshape(-1, found.shape[-1]))
        wrong.append(film.limbs_wrong.ravel())
        weight.append(np.full(film.limbs_wrong.size, each))
        for _ in range(LEAPS if film.kind == "good" else 0):
            if (leap := leaping(film, rng)) is not None:
                results, frame, limb = leap
                rows.append(limb_features(results, film.run.character.skeleton, logit)[frame, limb][None])
                wrong.append(np.array([True]))
                weight.append(np.array([each]))
    return np.concatenate(rows), np.concatenate(wrong), np.concatenate(weight)


def stretched(model: RiskModel, logit: np.ndarray, wrong: np.ndarray, weight: np.ndarray) -> RiskModel:
    """Stretch and shift a model's logits so that its probabilities are those of some films (Platt 1999)."""
    weight = weight / weight.sum()

    def loss(values: np.ndarray) -> float:
        found = values[0] + values[1] * logit
        return float((weight * (np.logaddexp(0, found) - wrong * found)).sum())

    shift, slope = minimize(loss, [0.0, 1.0], method="Nelder-Mead").x
    weights = tuple(round(float(slope * value), 3) for value in model.weights)
    return model._replace(intercept=round(float(slope * model.intercept + shift), 3), weights=weights)


def left_out(films: Sequence[Film], model: RiskModel, parts: int = 9) -> None:
    """Print how models do on films that neither they nor their stretching saw: every part of the seeds in turn."""
    seeds = np.array([int(film.run.name[:4]) for film in films])
    found: dict[str, list[np.ndarray]] = {"as it is": [], "stretched": [], "fitted anew": []}
    order: list[Film] = []
    for part in range(parts):
        others, own = ([f for f, s in zip(films, seeds, strict=True) if (s % parts == part) == of] for of in (0, 1))
        features, wrong, weight = per_frame(others)
        models = {
            "as it is": model,
            "stretched": stretched(model, model.logit(features), wrong, weight),
            "fitted anew": fitted(FRAME_FEATURES, features, wrong, weight, FRAME_RIDGE),
        }
        for film in own:
            order.append(film)
            for name, one in models.items():
                found[name].append(probability(one.logit(film.features)))
    _, wrong, weight = per_frame(order)
    good = np.concatenate([np.full(len(film.wrong), film.kind == "good") for film in order])
    print(
        f"films left out: {len(order)}, {(~wrong & good).sum()} right frames of good ones, {wrong.sum()} wrong frames"
    )
    for name, parts_found in found.items():
        risk = np.concatenate(parts_found)
        surprise = -np.log(np.where(wrong, risk, 1 - risk))
        trusted = [int((risk[wrong] <= np.quantile(risk[~wrong & good], of)).sum()) for of in (0.8, 0.9, 0.95)]
        print(
            f"  {name}: log loss {np.average(surprise, weights=weight):.3f}, Brier score "
            f"{np.average((risk - wrong) ** 2, weights=weight):.3f}; wrong frames trusted where 80, 90, 95 % of the "
            f"right ones of good films are: {trusted}"
        )
        print_reliability(risk, wrong, weight)


def print_reliability(risk: np.ndarray, wrong: np.ndarray, weight: np.ndarray) -> None:
    """Print predicted and found shares of wrong frames."""
    for low, high in ((0, 0.02), (0.02, 0.1), (0.1, 0.2), (0.2, 0.3), (0.3, 0.5), (0.5, 0.7), (0.7, 1.001)):
        of = (risk >= low) & (risk < high)
        if of.any():
            print(
                f"    risk {low:.2f} to {min(high, 1):.2f}: {np.average(risk[of], weights=weight[of]):.3f} predicted, "
                f"{np.average(wrong[of], weights=weight[of]):.3f} found, {of.sum()} frames"
            )


class Errors(NamedTuple):
    """A film's errors of joints in metres, and what their covariance is made of; `ours` are the joints' landmarks."""

    film: Film
    ours: list[int]
    vectors: np.ndarray
    confidence: np.ndarray

    @classmethod
    def of(cls, film: Film) -> "Errors":
        run = film.run
        skeleton = run.character.skeleton
        ours = [skeleton.landmark_names.index(name) for name in run.joint_names]
        theirs = [run.truth_names.index(name) for name in run.joint_names]
        places = np.stack([np.asarray(landmark_positions(skeleton, result.pose)) for result in run.results])
        confidence = judge_sequence(run.results, skeleton, SETTINGS, run.registered, run.cameras).confidence
        return cls(film, ours, places[:, ours] - run.truth[:, theirs], confidence)

    def scored(self, settings: UncertaintySettings) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Squared distances in deviations, the logarithms of the determinants, and the joint each is of."""
        character, results = self.film.run.character, self.film.run.results
        misfit = float(character.misfit)
        matrix = joint_covariances(character.skeleton, results, settings, self.confidence, misfit)[:, self.ours]
        matrix = matrix.astype(float)
        squared = np.einsum("tja,tjab,tjb->tj", self.vectors, np.linalg.inv(matrix), self.vectors)
        known = np.isfinite(squared)
        joints = np.broadcast_to(np.array(self.film.run.joint_names), squared.shape)
        return squared[known], np.linalg.slogdet(matrix)[1][known], joints[known]


def fit_uncertainty(errors: Sequence[Errors]) -> tuple[float, float, float, float, float]:
    """Scale, doubt, floor and free angle of `UncertaintySettings`, and `motion.TAILS`, of greatest likelihood."""

    def loss(logarithms: np.ndarray) -> float:
        *settings, tails = np.exp(logarithms)
        cost = 0.0
        for film in errors:
            squared, determinant, _ = film.scored(settings_of(*settings))
            likelihood = gammaln((tails + 3) / 2) - gammaln(tails / 2) - 1.5 * np.log(tails * np.pi)
            cost -= (likelihood - determinant / 2 - (tails + 3) / 2 * np.log1p(squared / tails)).mean()
        return cost

    usual = UncertaintySettings()
    begin = np.log([usual.scale, usual.doubt, usual.floor, usual.free_angle, TAILS])
    found = minimize(loss, begin, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 0.01})
    return tuple(round(float(value), 4) for value in np.exp(found.x))


def settings_of(scale: float, doubt: float, floor: float, free_angle: float) -> UncertaintySettings:
    """Settings that are fitted, beside those that are not."""
    return UncertaintySettings(scale=scale, doubt=doubt, floor=floor, free_angle=free_angle)


def held(errors: Sequence[Errors], name: str) -> list[Figure]:
    """How often regions of the uncertainty hold the true joints, all of them and limb by limb."""
    scored = [film.scored(UncertaintySettings()) for film in errors]
    squared, joints = np.concatenate([one[0] for one in scored]), np.concatenate([one[2] for one in scored])
    inside = {share: squared <= 3 * f.ppf(share, 3, TAILS) for share in (0.5, 0.9, 0.99)}
    for joint in dict.fromkeys(joints.tolist()):
        of = joints == joint
        print(f"  {joint:12s}" + "".join(f" {share:.0%}: {held[of].mean():.0%}" for share, held in inside.items()))
    return [
        record(f"{name}: coverage of the {share:.0%} region", float(held.mean()), "", 0.1)
        for share, held in inside.items()
    ]


def lost_limbs(verdict: SequenceVerdict, film: Film) -> np.ndarray:
    """Which limbs the verdict lists as lost in which frames."""
    frames = np.array([result.frame for result in film.run.results])
    labels = list(film.run.character.skeleton.limb_labels.values())
    lost = np.zeros((len(frames), len(labels)), bool)
    for span in verdict.lost:
        inside = (frames >= span.first) & (frames <= span.last)
        for limb, label in enumerate(labels):
            lost[:, limb] |= inside & (span.part in ("body", label))
    return lost


def judged(films: Sequence[Film], name: str) -> list[Figure]:
    """Judge films by the verdict as it is in the library; a table by kind, and figures."""
    rows: dict[str, np.ndarray] = {}
    risks, wrongs, leaps, rng = [], [], np.zeros(2), np.random.default_rng(1)
    for film in films:
        run = film.run
        skeleton = run.character.skeleton
        verdict = judge_sequence(run.results, skeleton, SETTINGS, run.registered, run.cameras)
        trusted = np.array(verdict.status) == "ok"
        limbs = trusted[:, None] & ~lost_limbs(verdict, film)
        counts = [(of & bad).sum() for bad in (~film.wrong, film.wrong) for of in (trusted, np.ones_like(trusted))]
        bad_limbs = film.limbs_wrong
        counts += [(of & bad).sum() for bad in (~bad_limbs, bad_limbs) for of in (limbs, np.ones_like(limbs))]
        rows[film.kind] = rows.get(film.kind, np.zeros(8, int)) + np.array(counts)
        risks.append(verdict.risk)
        wrongs.append(film.wrong)
        for _ in range(2 * LEAPS if not film.wrong.any() else 0):
            if (leap := leaping(film, rng)) is not None:
                results, frame, limb = leap
                found = judge_sequence(results, skeleton, SETTINGS, run.registered, run.cameras)
                caught = lost_limbs(found, film)[frame, limb] or found.status[frame] != "ok"
                leaps += [caught, 1]
    heads = ("right frames trusted", "wrong frames trusted", "right limbs trusted", "wrong limbs trusted")
    print(f"{name:16s}" + "".join(f"{head:>22s}" for head in heads))
    total = sum(rows.values())
    for kind, row in (*sorted(rows.items()), ("all", total)):
        print(f"{kind:16s}" + "".join(f"{f'{row[k]} of {row[k + 1]}':>22s}" for k in range(0, 8, 2)))
    risk, wrong = np.concatenate(risks), np.concatenate(wrongs)
    print_reliability(risk, wrong, per_frame(films)[2])
    figures = [
        record(f"{name}: right frames trusted", float(total[0] / max(total[1], 1)), "", 0.03, "higher"),
        record(f"{name}: wrong frames not trusted", float(1 - total[2] / max(total[3], 1)), "", 0.03, "higher"),
        record(f"{name}: right limbs trusted", float(total[4] / max(total[5], 1)), "", 0.03, "higher"),
        record(f"{name}: wrong limbs not trusted", float(1 - total[6] / max(total[7], 1)), "", 0.03, "higher"),
        record(f"{name}: Brier score of frames", float(((risk - wrong) ** 2).mean()), "", 0.1),
    ]
    if leaps[1]:
        figures.append(record(f"{name}: leaps of a limb caught", float(leaps[0] / leaps[1]), "", 0.03, "higher"))
    return figures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("corpus", type=Path)
    add_options(parser)
    options = parser.parse_args()
    runs = [read_run(file) for file in sorted(options.corpus.glob("*.npz"))]
    films = [Film.of(run) for run in runs if run.results]
    halves = {name: [f for f in films if half_of(f.run.name) == name] for name in ("fit", "judge", "real")}
    print("fitted anew:", *fit(halves["fit"]), sep="\n")
    own = halves["fit"] + halves["judge"]
    features, wrong, weight = per_frame(own)
    print("stretched to both halves:", stretched(FRAME_MODEL, FRAME_MODEL.logit(features), wrong, weight), sep="\n")
    rows, limbs_wrong, weight = limb_samples(own, FRAME_MODEL)
    print(stretched(LIMB_MODEL, LIMB_MODEL.logit(rows), limbs_wrong, weight))
    left_out(own, FRAME_MODEL)
    good = {name: [Errors.of(f) for f in chosen if f.kind in GOOD] for name, chosen in halves.items()}
    print("scale, doubt, floor, free angle, tails:", *fit_uncertainty(good["fit"]))
    figures: list[Figure] = []
    for name, chosen in halves.items():
        figures += judged(chosen, name) if chosen else []
        figures += held(good[name], name) if good[name] else []
    return finish(figures, options, films={name: len(chosen) for name, chosen in halves.items()})


if __name__ == "__main__":
    raise SystemExit(main())
