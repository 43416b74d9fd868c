"""The tracker as a value: what is searched, with how much effort, and how the result is refined."""

from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from jaxmocap._results import InputError
from jaxmocap._types import Knob, knob
from jaxmocap.appearance import AppearanceSettings, ForegroundSettings
from jaxmocap.energies import ContourSettings, Keypoints, SearchEnergy, search_energy
from jaxmocap.observation import LightSettings
from jaxmocap.refiners import AbstractRefiner, LeastSquares
from jaxmocap.samplers import AbstractSampler, InteractingSimulatedAnnealing, particles_for

from ._confidence import VerdictSettings
from ._economy import Calm, Hindsight, Retry
from ._past import AngleChoice
from ._polish import PolishPlan
from ._surface_flow import FlowSettings

Quality = Literal["draft", "normal", "paper"]


class Effort(NamedTuple):
    """Some iterations of the search that look at every `step`-th pixel and draw a mesh with this share of its faces."""

    step: int = 1
    iterations: int = 25
    faces: float = 1.0


@dataclass(frozen=True)
class SearchPlan:
    """Effort of the annealing: `stages` run from coarse to fine; `particles` per
    group (None: 2^n + 40, the paper); `spread` multiplies the first particles' deviation; `wide` is the share
    of a limb's first particles that look further afield (0 is the paper); `trunk` scales particles and spread of root
    and torso, which are large and move less than limbs; `calm` says when a group need not be searched, `retry` when a
    limb is searched again (None: never, the paper), `hindsight` when in an earlier frame; after a frame whose verdict
    is "lost", root and torso are searched `reacquire` times further afield (0: never, the paper). `prior` is what a
    particle pays for leaving the start in a degree of freedom, half of it at one deviation and never more than all
    (Geman and McClure 1985): where the pictures leave a direction open, as depth when the views are close together, it
    stays where flow and prediction put it (0: the paper, which has no motion prior here). `answer` "mean" is the
    paper's. `groups` "whole" searches all 39 degrees of freedom at once instead of the paper's hierarchy, and
    then needs `particles`."""

    stages: tuple[Effort, ...] = (Effort(),)
    particles: int | None = None
    spread: float = 1.0
    wide: float = 0.0
    trunk: float = 1.0
    calm: Calm | None = None
    retry: Retry | None = None
    hindsight: Hindsight | None = None
    reacquire: int = 0
    prior: float = 0.0
    answer: Literal["mean", "best_if_better"] = "best_if_better"
    groups: Literal["hierarchy", "whole"] = "hierarchy"

    def __post_init__(self) -> None:
        if self.groups == "whole" and self.particles is None:
            raise InputError("a search of the whole body at once needs a number of particles: 2^39 are too many.")

    @property
    def iterations(self) -> int:
        """Of all stages."""
        return sum(stage.iterations for stage in self.stages)

    def count(self, num_dofs: int, share: float = 1.0) -> int:
        """Particles of a group."""
        return round(share * (particles_for(num_dofs) if self.particles is None else self.particles))

    def sampler(self, num_dofs: int, sigma_min: Float[Array, "dof"], share: float = 1.0) -> AbstractSampler:
        """The annealing of one group, with a share of the particles."""
        return InteractingSimulatedAnnealing(
            num_particles=self.count(num_dofs, share),
            num_iterations=self.iterations,
            answer=self.answer,
            sigma_min=sigma_min,
        )


class RefineWeights(eqx.Module):
    """Numbers of Eqs 8 to 10, all array leaves.

    `regularisation` is lambda_reg = 3 of the paper; `residual_scale` the metres that count as 1 in the data term (the
    paper gives no unit): with it the L1's dead zone is about 0.06 degrees for a forearm. `prior` scales the pull to the
    autoregression's prediction against lambda_reg, 1 is the paper. `robust` is the Geman-McClure scale in metres.
    """

    regularisation: Knob = knob(3.0)
    residual_scale: Knob = knob(0.10)
    prior: Knob = knob(1.0)
    robust: Knob = knob(0.02)
    contour: Knob = knob(1.0)
    surface: Knob = knob(1.0)


@dataclass(frozen=True)
class RefinePlan:
    """The local refinement: `rounds` of association and solving; `robust_start` widens the robust scale of the first
    round, halved every round; `edges` is where contours look for their edge, the Canny picture (the paper) or the
    outline of what is not background; `surface_flow` adds to the paper's contour rows the correspondences carried over
    the surface from the selected frames and the other views."""

    rounds: int = 6
    steps: int = 2
    robust_start: float = 1.0
    contours: ContourSettings = field(default_factory=ContourSettings)
    edges: Literal["canny", "background"] = "canny"
    surface_flow: bool = False
    flow: FlowSettings = field(default_factory=FlowSettings)
    weights: RefineWeights = field(default_factory=RefineWeights)
    refiner: AbstractRefiner = field(default_factory=LeastSquares)
    autoregression: Literal["ridge", "quadratic", "velocity"] = "ridge"


@dataclass(frozen=True)
class DetectionPlan:
    """How a detector's keypoints count, where the observations have any: as the term `search` of the search energy, and
    as rows of the refinement, where `scale` metres from a point's ray count as 1 and beyond `robust` metres it fades.
    """

    search: Keypoints = field(default_factory=Keypoints)
    scale: float = 0.1
    robust: float = 0.05


@dataclass(frozen=True)
class Tracker:
    """`Tracker()` is the paper. `Tracker.preset(quality)` are the settings of the command line's `--quality`.

    `search_energy` is Eq. 5. `search` None skips the sample-based search, `refine` None the refinement (the ablations
    of Figs. 12 and 14). `polish` follows the search downhill on its own energy before the refinement; not in the paper.
    `detections` lets keypoints count, where there are any, and makes the tracker a hybrid; None is photometric.
    `flow_start` starts each frame from optical flow (sec. 4.1, Initialization). `angles` "roomier" begins each frame
    with those of the two sets of angles of a shoulder or hip that are farther from the joint limits (the same
    rotation, see `character.roomier`); "same" is the paper. `prediction` starts the root, the torso and each limb
    where the last motion would lead if that scores better than the flow; the paper does not. At most `longest_flash`
    frames in a row, not selected ones, are passed over when the light jumps, and lie between their neighbours (0: none,
    the paper). With `light` every frame is brought into the light of the first before anything looks at it; None is the
    paper.
    """

    search_energy: SearchEnergy = field(default_factory=search_energy)
    search: SearchPlan | None = field(default_factory=SearchPlan)
    refine: RefinePlan | None = field(default_factory=RefinePlan)
    polish: PolishPlan | None = None
    detections: DetectionPlan | None = None
    flow_start: bool = True
    prediction: bool = False
    angles: AngleChoice = "same"
    longest_flash: int = 0
    flow: FlowSettings = field(default_factory=FlowSettings)
    light: LightSettings | None = None
    verdict: VerdictSettings = field(default_factory=VerdictSettings)

    @property
    def scored(self) -> SearchEnergy:
        """The energy that frames are scored by: `search_energy`, with the detections if they count."""
        extra = () if self.detections is None else (self.detections.search,)
        return SearchEnergy((*self.search_energy.terms, *extra))

    @staticmethod
    def preset(quality: Quality = "normal") -> "Tracker":
        """Settings by name: "paper" is the published method and budget, "normal" the best accuracy per second, "draft"
        a quick look."""
        if quality == "paper":
            return Tracker()
        fast = search_energy(
            posture=0.005, uncovered_scale=4.0, step=2, sampling="nearest", fail="ignore", outside="ignore"
        )
        plan = RefinePlan(
            surface_flow=True,
            rounds=4,
            robust_start=4.0,
            weights=RefineWeights(regularisation=0.3, residual_scale=0.02, prior=0.3, robust=0.015),
            contours=ContourSettings(reach=10),
        )
        efforts = (Effort(4, 10, 0.25), Effort(2, 6, 0.5))
        habits = {"prediction": True, "angles": "roomier", "longest_flash": 3, "light": LightSettings()}
        if quality == "normal":
            economy = {"calm": Calm(), "retry": Retry(), "hindsight": Hindsight(), "reacquire": 3}
            search = SearchPlan(efforts, particles=96, trunk=0.6, wide=0.25, prior=0.002, **economy)
            return Tracker(fast, search, plan, **habits)
        if quality == "draft":
            coarse = SearchPlan((Effort(4, 8, 0.25),), particles=48, spread=0.6, prior=0.002)
            return Tracker(fast, coarse, replace(plan, rounds=2), **habits)
        raise InputError(f"quality '{quality}' is unknown; choose draft, normal or paper.")


def appearance_preset(quality: Quality) -> AppearanceSettings:
    """Appearance settings that go with a preset: "paper" leaves triangles that were never seen without a model, and
    knows the background by the grid's colour models only."""
    if quality == "paper":
        return AppearanceSettings()
    return AppearanceSettings(foreground=ForegroundSettings(unseen="nearest"), behind="plate")


def sigma_floor(dofs: tuple[int, ...]) -> Float[Array, "group_dof"]:
    """Smallest spread the annealing keeps: 2 mm for translations, 0.25 degrees for angles."""
    return jax.device_put(np.array([0.002 if dof < 3 else 0.00436 for dof in dofs], np.float32))
