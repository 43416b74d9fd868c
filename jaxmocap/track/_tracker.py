"""The tracker as a value: what is searched, with how much effort, and how the result is refined."""

from dataclasses import dataclass, field, replace

from jaxmocap._results import InputError
from jaxmocap._types import Quality
from jaxmocap.clip import ClipPlan
from jaxmocap.energies import ContourSettings, SearchEnergy, search_energy
from jaxmocap.motion import AngleChoice
from jaxmocap.refinement import DetectionPlan, FlowSettings, RefinePlan, RefineWeights
from jaxmocap.samplers import AbstractSampler, InteractingSimulatedAnnealing
from jaxmocap.search import Gating, PolishPlan, Retry, SearchPlan
from jaxmocap.verdict import VerdictSettings

from ._backward_search import BackwardSearch


@dataclass(frozen=True)
class Tracker:
    """Say how to track. `Tracker()` is the paper; `Tracker.preset(quality)` are the settings of `--quality`.

    Attributes:
        search_energy: what a particle is scored by; Eq. 5.
        search: how much effort the search makes; None leaves it out (Fig. 12).
        refine: the local refinement of sec. 4.2; None leaves it out (Fig. 14).
        sampler: how the search proposes particles, any of `jaxmocap.samplers`; `search` sets its sizes for each group;
            the annealing of sec. 4.1.
        polish: follow the search downhill on its own energy before the refinement; None is the paper.
        backward_search: search limbs of earlier frames again that a later frame shows to be wrong; None is the paper.
        detections: let keypoints count where there are any, a hybrid; None is photometric (the paper).
        flow_start: start each frame from optical flow (sec. 4.1, Initialization).
        prediction: start root, torso and limbs where the last motion would lead if that scores better than the flow;
            False is the paper.
        angles: "away_from_limits" begins each frame with those of the two equivalent sets of angles of a shoulder or
            hip that are farther from the joint limits (see `character.away_from_limits`); "same" is the paper.
        longest_flash: frames in a row, not selected ones, that are passed over when the light jumps, and then lie
            between their neighbours; 0 is the paper.
        flow: how optical flow is computed, for the start, the refinement and the verdict.
        light: bring every frame into the light of the first before anything looks at it; False is the paper.
        clip: solve all frames together once they are tracked; None is the paper.
        verdict: when a frame or a part of it is doubtful or lost; ours.
    """

    search_energy: SearchEnergy = field(default_factory=search_energy)
    search: SearchPlan | None = field(default_factory=SearchPlan)
    refine: RefinePlan | None = field(default_factory=RefinePlan)
    sampler: AbstractSampler = field(default_factory=InteractingSimulatedAnnealing)
    polish: PolishPlan | None = None
    backward_search: BackwardSearch | None = None
    detections: DetectionPlan | None = None
    flow_start: bool = True
    prediction: bool = False
    angles: AngleChoice = "same"
    longest_flash: int = 0
    flow: FlowSettings = field(default_factory=FlowSettings)
    light: bool = False
    clip: ClipPlan | None = None
    verdict: VerdictSettings = field(default_factory=VerdictSettings)

    @property
    def scored(self) -> SearchEnergy:
        """The energy that frames are scored by: `search_energy`, with the detections if they count."""
        extra = () if self.detections is None else (self.detections.search,)
        return SearchEnergy((*self.search_energy.terms, *extra))

    @staticmethod
    def preset(quality: Quality = "normal") -> "Tracker":
        """Choose settings by name.

        "paper" is the published method and budget, "normal" the best accuracy per second, "draft" a quick look.
        """
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
        habits = {
            "prediction": True,
            "angles": "away_from_limits",
            "longest_flash": 3,
            "light": True,
            "clip": ClipPlan(),
        }
        if quality == "normal":
            search = SearchPlan(
                step=2,
                iterations=16,
                faces=0.25,
                particles=96,
                trunk=0.6,
                wide=0.25,
                prior=0.002,
                gating=Gating(),
                retry=Retry(),
                relocalise=3,
            )
            return Tracker(fast, search, plan, backward_search=BackwardSearch(), **habits)
        if quality == "draft":
            coarse = SearchPlan(step=4, iterations=8, faces=0.25, particles=48, spread=0.6, prior=0.002)
            habits["clip"] = ClipPlan(flow=False)  # which takes half as long as so quick a search
            return Tracker(fast, coarse, replace(plan, rounds=2), **habits)
        raise InputError(f"quality '{quality}' is unknown; choose draft, normal or paper.")
