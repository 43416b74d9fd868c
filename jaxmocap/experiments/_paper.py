"""The paper's section 5 as a list of trials: competitors on every capture, and one factor at a time."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from jaxmocap._types import Quality
from jaxmocap.baselines import METHODS
from jaxmocap.track import Tracker

from ._run import Inputs, Run, Trial
from ._suite import STORIES, CaptureSpec, story

Changes = tuple[dict[str, Any], dict[str, Any]]
"""Of settings of the tracker and of the appearance."""

Setting = tuple[str, dict[str, Any], dict[str, Any]]
"""A value's name, and what it changes of the tracker and of the appearance."""

LIGHT, ARMS = "changing-light", "background-like-arms"
NO_BACKGROUND = {"search_energy.terms.model_view.uncovered_scale": 1.0}
RESCUES = {
    "arms-like-torso": "no background",
    "uniform-arm": "no background",
    "background-like-arms": "no background",
    "fast-motion": "no search",
    "changing-light": "no view-view",
    "narrow-angle": "no view-view",
}
"""For each capture what the paper says it depends on, left out."""
FIGURE_1 = ("arms-like-torso", "uniform-arm", "background-like-arms")


def without(term: str, quality: Quality) -> Setting:
    """Leave out a part of the method, everything else as it is."""
    if term == "no background":
        return term, dict(NO_BACKGROUND), {"behind": "none"}
    if term == "no search":
        return term, {"search": "off", "prediction": "false"}, {}
    if term == "no view-view":
        return term, {"search_energy.terms.view_view.weight": 0.0}, {}
    if term == "no light":
        return term, {"light": False}, {}
    if term == "no L1":
        plan = Tracker.preset(quality).refine
        assert plan is not None
        tiny, weights = 1e-4, plan.weights
        kept = float(weights.regularisation) * float(weights.prior) / tiny  # Eq. 10's second term stays what it is
        return term, {"refine.weights.regularisation": tiny, "refine.weights.prior": kept}, {}
    raise ValueError(f"there is no part called '{term}'")


def comparison(
    captures: Sequence[CaptureSpec | str],
    seeds: Iterable[int],
    base: Run,
    methods: Sequence[str] = tuple(METHODS),
) -> list[Trial]:
    """List the trials of every method on every capture (Fig. 15)."""
    return [
        Trial("comparison", "method", name, replace(base, capture=capture, method=name, seed=seed))
        for capture in captures
        for seed in seeds
        for name in methods
    ]


def ablation(
    experiment: str,
    factor: str,
    settings: Sequence[Setting],
    captures: Sequence[CaptureSpec],
    seeds: Sequence[int],
    base: Run,
) -> list[Trial]:
    """List trials of the tracker with one factor changed at a time."""
    return [
        Trial(
            experiment,
            factor,
            value,
            replace(base, capture=capture, seed=seed, settings=tracker, appearance=appearance),
        )
        for capture in captures
        for seed in seeds
        for value, tracker, appearance in settings
    ]


def varied(
    experiment: str,
    factor: str,
    captures: Mapping[str, CaptureSpec],
    seeds: Sequence[int],
    base: Run,
    inputs: Inputs | None = None,
) -> list[Trial]:
    """List trials of the tracker on the same capture filmed in several ways."""
    base = base if inputs is None else replace(base, inputs=inputs)
    return [
        Trial(experiment, factor, value, replace(base, capture=capture, seed=seed))
        for value, capture in captures.items()
        for seed in seeds
    ]


def given(
    experiment: str,
    factor: str,
    inputs: Mapping[str, Inputs],
    captures: Sequence[CaptureSpec],
    seeds: Sequence[int],
    base: Run,
) -> list[Trial]:
    """List trials of the tracker with other inputs."""
    return [
        Trial(experiment, factor, value, replace(base, capture=capture, seed=seed, inputs=one))
        for capture in captures
        for seed in seeds
        for value, one in inputs.items()
    ]


def paper(
    quick: bool = False,
    seeds: Sequence[int] | None = None,
    quality: Quality | None = None,
) -> list[Trial]:
    """List all trials of section 5 on the suite.

    `quick` is one seed, small captures, of each ablation only on and off, and the preset "draft" where no `quality` is
    named.
    """
    seeds = (0,) if quick and seeds is None else (0, 1, 2) if seeds is None else tuple(seeds)
    quality = ("draft" if quick else "normal") if quality is None else quality
    captures = {name: story(name, quick=quick) for name in STORIES}
    base = Run(captures[LIGHT], quality=quality)
    trials = comparison(list(captures.values()), seeds, base)
    whole: Setting = ("all parts", {}, {})
    for name, capture in captures.items():
        parts = [RESCUES[name]] if quick else ["no background", "no search", "no view-view", "no L1"]
        parts += ["no light"] if name == LIGHT else []  # ours, not the paper's
        settings = [whole, *(without(part, quality) for part in parts)]
        trials += ablation("stories", "part left out", settings, [capture], seeds, base)
    last = captures[ARMS].arguments["num_frames"] - 1
    chosen = {0: (0,), 1: (0,), 2: (0, last // 2 + last % 2), 5: tuple(captures[ARMS].arguments["selected_frames"])}
    counts = (0, 1, 2) if quick else tuple(chosen)
    for count in counts:
        settings = [without("no background", quality) if count == 0 else whole]
        settings = [(f"{count} selected frames", *settings[0][1:])]
        inputs = replace(base, inputs=Inputs(selected=chosen[count]))
        trials += ablation("Fig. 11 background", "selected frames", settings, [captures[ARMS]], seeds, inputs)
    trials += ablation(
        "Fig. 12 search", "search", [whole, without("no search", quality)], [captures["fast-motion"]], seeds, base
    )
    trials += ablation(
        "Fig. 13 view-view", "view-view", [whole, without("no view-view", quality)], [captures[LIGHT]], seeds, base
    )
    trials += ablation("Fig. 14 L1", "L1", [whole, without("no L1", quality)], [captures["uniform-arm"]], seeds, base)
    return trials if quick else trials + _as_printed(captures, seeds, base, quality) + _more(captures, seeds, base)


def _silhouettes(dance: CaptureSpec, seeds: Sequence[int], base: Run) -> list[Trial]:
    """List trials of the methods that rest on silhouettes, and of ours.

    The views are few and near, few and far apart, and more: the order of Fig. 15 depends on that.
    """
    captures = [
        replace(
            dance.varied(num_cameras=views, view_angle_degrees=degrees), name=f"{views}-views-{degrees:g}-degrees-apart"
        )
        for views, degrees in ((2, 27.0), (2, 80.0), (3, 60.0))
    ]
    methods = ("ours", "hasler-5", "posecut", "hasler-1")
    return [replace(trial, experiment="Fig. 15 views") for trial in comparison(captures, seeds, base, methods)]


def _as_printed(captures: Mapping[str, CaptureSpec], seeds: Sequence[int], base: Run, quality: Quality) -> list[Trial]:
    """List the stories of Fig. 1 without the prior of the search, which the paper lacks and which rescues, too."""
    parts: list[Setting] = [
        ("all parts", {}, {}),
        *(without(f"no {term}", quality) for term in ("background", "view-view")),
    ]
    settings = [(name, {**tracker, "search.prior": 0.0}, appearance) for name, tracker, appearance in parts]
    told = [captures[name] for name in FIGURE_1]
    return ablation("stories without the prior", "part left out", settings, told, seeds, base)


def _more(captures: Mapping[str, CaptureSpec], seeds: Sequence[int], base: Run) -> list[Trial]:
    """List trials of what the paper does not vary, and of the resolution of its grid."""
    arms, light = captures[ARMS], captures[LIGHT]
    weight = "search_energy.terms.view_view.weight"

    def swept(name: str, values: Sequence[Any], settings: Callable[[Any], Changes]) -> list[Trial]:
        return ablation(name, name, [(f"{value}", *settings(value)) for value in values], [arms], seeds, base)

    grid = lambda n: ({}, {"behind": "grid", "grid.rows": n, "grid.columns": n})  # noqa: E731
    trials = swept("background grid", (10, 13, 16, 20), grid)
    trials += swept("lambda", (0.0, 0.1, 0.3, 1.0, 3.0), lambda v: ({weight: v}, {}))
    trials += swept("particles", (24, 48, 96, 192), lambda v: ({"search.particles": v}, {}))
    trials += swept("iterations", (6, 16, 32), lambda v: ({"search.iterations": v}, {}))
    trials += swept("every n-th pixel", (2, 4), lambda v: ({"search.step": v}, {}))
    palette = {"search.faces": 1.0}
    exact = {**palette, "search_energy.terms.model_view.shading": "exact"}
    shading = [("palette", palette, {}), ("exact", exact, {})]
    trials += ablation("shading", "shading", shading, [arms], seeds, base)
    dance = CaptureSpec("dance", {k: v for k, v in arms.arguments.items() if k != "scenery"})
    angles = {f"{a}": dance.varied(view_angle_degrees=float(a)) for a in (5, 10, 20, 27, 40)}
    trials += varied("view angle", "degrees", angles, seeds, base)
    cameras = {f"{n}": dance.varied(num_cameras=n) for n in (1, 2, 3)}
    trials += varied("cameras", "cameras", cameras, seeds, base, Inputs(start="truth"))
    trials += _silhouettes(dance, seeds, base)
    sizes = {f"{w} x {h}": dance.varied(size=(w, h)) for w, h in ((240, 136), (320, 180), (480, 270), (640, 360))}
    trials += varied("resolution", "pixels", sizes, seeds, base)
    dimming = {f"{v}": light.varied(illumination_change=v) for v in (0.0, 0.2, 0.35, 0.5)}
    trials += varied("illumination", "change", dimming, seeds, base)
    wrong = {f"{v}": Inputs(camera_degrees=v, camera_centimetres=2 * v) for v in (0.0, 0.1, 0.3, 1.0)}
    trials += given("calibration noise", "degrees", wrong, [dance], seeds, base)
    rough = {f"{v}": Inputs(mesh_millimetres=v) for v in (0.0, 2.0, 5.0, 10.0)}
    return trials + given("mesh noise", "millimetres", rough, [dance], seeds, base)
