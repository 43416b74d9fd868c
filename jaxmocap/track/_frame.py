"""One frame: start from flow, search group by group, refine. Sec. 4 of the paper from top to bottom."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxmocap.camera import Cameras
from jaxmocap.character import Character, Pose, difference, retract, skin
from jaxmocap.energies import Region, contour_lines, covered_cost, prepare_base, score_particles
from jaxmocap.motion import predict_difference
from jaxmocap.observation import FrameImages, FrameProblem, Observations, Rectangle, build_problem
from jaxmocap.refiners import Shooting
from jaxmocap.render import face_ids

from ._confidence import dominant_bodies, judge
from ._economy import Restraint, Retry, group_bodies, mean_costs
from ._least_squares import Prior, Rows, descend, free_prior
from ._polish import polish
from ._register import draw, frame_rectangle
from ._search import GroupSearch, Stage, group_searches, initial_spread, is_limb, simplified_mesh
from ._surface_flow import Source, surface_flow
from ._tracker import RefinePlan, SearchPlan, Tracker, sigma_floor

FLOW_ROBUST = (0.08, 0.03)
"""Geman-McClure scales of the flow start's rounds, metres."""


@dataclass
class FrameResult:
    """What was found in one frame: the pose, the energies of Eq. 5 by term, how far it may be trusted, the deviation
    of the last particles (39,), the J^T J of the refinement, and seconds by stage."""

    frame: int
    timestamp: float
    pose: Pose
    energy: dict[str, float]
    confidence: Float[np.ndarray, "landmark"]
    status: str
    deviation: Float[np.ndarray, "dof"]
    hessian: Float[np.ndarray, "dof dof"] | None
    seconds: dict[str, float]


@dataclass
class Clock:
    """Seconds by stage."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        begin = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin


@eqx.filter_jit
def _score(energy, character, part, pose, problem, increments, capacity):
    height, width = problem.size
    region = Region(jnp.zeros((problem.num_cameras, 2), jnp.int32), (height, width))
    base = prepare_base(energy, character, part, pose, problem, region, capacity)
    return score_particles(energy, character, part, pose, problem, region, base, increments, capacity)


@eqx.filter_jit
def covered_costs(ids: Int[Array, "camera height width"], problem: FrameProblem) -> Float[Array, "camera height width"]:
    """Eq. 6 per pixel as if every pixel were covered by its face."""
    table = problem.surface.colour_distance
    flat = jnp.maximum(ids, 0) * table.shape[2] + problem.labels
    foreground = jnp.stack([table[c].reshape(-1)[flat[c]] for c in range(problem.num_cameras)]).astype(jnp.float32)
    return covered_cost(foreground, problem.background)


def unexplained(ids: Int[np.ndarray, "camera height width"], problem: FrameProblem) -> float:
    """Share of the person's pixels that look foreign but are not covered, in the view where it is largest; thin seams
    do not count."""
    covered, foreign = ids >= 0, np.asarray(problem.background) > 0.5
    shares = []
    for camera in range(problem.num_cameras):
        beside = (foreign[camera] & ~covered[camera]).astype(np.uint8)
        width = 2 * round(0.05 * np.sqrt(covered[camera].sum()) / 2) + 1
        blobs = cv2.morphologyEx(beside, cv2.MORPH_OPEN, np.ones((width, width), np.uint8))
        shares.append(blobs.sum() / max(covered[camera].sum(), 1))
    return float(max(shares))


class FrameTracker:
    """Tracks one frame after the other; what one frame hands to the next lives here (host)."""

    def __init__(self, observations: Observations, tracker: Tracker, key: PRNGKeyArray):
        self.observations = observations
        self.character: Character = observations.character
        self.cameras: Cameras = observations.cameras
        self.tracker = tracker
        self.key = key
        shares = {stage.faces for stage in tracker.search.stages} - {1.0} if tracker.search is not None else set()
        meshes = {share: simplified_mesh(self.character, observations.surface, share) for share in sorted(shares)}
        self.groups = group_searches(self.character, meshes)
        self.far_groups = [g for g in group_searches(self.character, meshes, everywhere=True) if is_limb(g)]
        self.spread = initial_spread(self.character)
        self.rectangle: Rectangle | None = None
        self.last: tuple[FrameImages, Pose] | None = None
        self.increments: list[np.ndarray] = []
        self.face_bodies = dominant_bodies(self.character)
        faces = np.asarray(self.character.faces)
        self.group_vertices = [np.unique(faces[np.asarray(group.part.moves)]) for group in self.groups]
        self.bodies = [group_bodies(self.character, group.dofs) for group in self.groups]
        self.outer_bodies = [group_bodies(self.character, group.dofs, outer=True) for group in self.far_groups]
        calm = tracker.search.calm if tracker.search is not None else None
        self.restraint = Restraint(calm, len(self.groups)) if calm is not None else None
        self._keys: dict[tuple[int, int], Source] = {}

    # Sources of surface correspondences -------------------------------------------------------------------------

    def _source(self, image: np.ndarray, frame: int, camera: int, pose: Pose) -> Source:
        view = self.cameras.at(frame)
        vertices = skin(self.character, pose)
        width, height = self.cameras.sizes[camera]
        ids, _ = face_ids(
            vertices,
            self.character.faces,
            view.intrinsics[camera : camera + 1],
            view.cam_from_world[camera : camera + 1],
            jnp.zeros((1, 2), jnp.int32),
            height,
            width,
        )
        return Source(image, view.intrinsics[camera], view.cam_from_world[camera], vertices, ids[0])

    def _selected_sources(self, frame: int) -> list[list[Source]]:
        """Per camera the nearest selected frame, seen by that camera."""
        serving = sorted(self.observations.key_poses, key=lambda g: (abs(g - frame), g))[:1]
        sources: list[list[Source]] = []
        for camera in range(self.cameras.num_cameras):
            row = []
            for selected in serving:
                if (camera, selected) not in self._keys:
                    image = self.observations.capture.image(camera, selected)
                    self._keys[camera, selected] = self._source(
                        image, selected, camera, self.observations.key_poses[selected]
                    )
                row.append(self._keys[camera, selected])
            sources.append(row)
        return sources

    # Stages -----------------------------------------------------------------------------------------------------

    def flow_start(self, shown: FrameImages, clock: Clock) -> tuple[Pose, Float[np.ndarray, "camera"]]:
        """The paper's [4]: the last frame carried over the surface, and where its points went; and the mean flow in
        pixels per view, which moves the rectangle."""
        assert self.last is not None
        before, pose = self.last
        with clock.stage("flow"):
            rectangle = frame_rectangle(
                np.asarray(skin(self.character, pose)), self.cameras, shown.frame, self.rectangle
            )
            sources = [[self._source(before.images[c], before.frame, c, pose)] for c in range(len(shown.images))]
            plain = self._plain_problem(shown, rectangle, pose)
            speed = np.zeros(len(shown.images))
            base = pose
            prior = free_prior(self.character, base, jnp.concatenate([jnp.full(6, 0.1), jnp.full(33, 0.5)]))
            for round_index, robust in enumerate(FLOW_ROBUST):
                vertices, ids, _ = draw(self.character, pose, plain)
                crops = [rectangle.crop(image, c) for c, image in enumerate(shown.images)]
                flows = surface_flow(self.character, vertices, ids, crops, plain, sources, self.tracker.flow)
                delta, _ = descend(
                    self.character,
                    base,
                    difference(self.character.skeleton, base, pose),
                    tuple(Rows(lines, 0.02, robust) for lines in flows),
                    (),
                    prior,
                    Shooting(),
                    steps=2,
                )
                pose = retract(self.character.skeleton, base, delta)
                if round_index == 0:
                    speed = self._pixel_speed(base, pose, shown.frame)
        return pose, speed

    def _pixel_speed(self, before: Pose, after: Pose, frame: int) -> Float[np.ndarray, "camera"]:
        view = self.cameras.at(frame)
        moved = np.linalg.norm(np.asarray(skin(self.character, after) - skin(self.character, before)), axis=1).mean()
        depth = np.asarray(skin(self.character, after)).mean(0)
        return np.array(
            [
                float(view.intrinsics[c, 0, 0])
                * moved
                / max(float(view.cam_from_world[c, 2, :3] @ depth + view.cam_from_world[c, 2, 3]), 0.1)
                for c in range(self.cameras.num_cameras)
            ]
        )

    def _plain_problem(self, shown: FrameImages, rectangle: Rectangle, pose: Pose) -> FrameProblem:
        return build_problem(
            shown.images,
            rectangle,
            self.cameras,
            shown.frame,
            np.asarray(skin(self.character, pose)),
            self.observations.surface,
        )

    def score(self, problem: FrameProblem, base: Pose, poses: list[Pose]) -> tuple[np.ndarray, np.ndarray]:
        """Eq. 5 of some poses on the full problem: totals, and terms (pose, term)."""
        root = self.groups[0]
        sizes, level = root.sizes.capacity, (1, 1.0)
        sizes.setdefault(level, 2 ** (self.character.faces.shape[0] - 1).bit_length())
        moved = [np.asarray(difference(self.character.skeleton, base, pose)) for pose in poses]
        increments = np.stack(moved + moved[-1:] * (-len(poses) % 4))  # few and many compile once
        while True:
            scores = _score(
                self.tracker.search_energy,
                self.character,
                root.part,
                base,
                problem,
                jnp.asarray(increments),
                sizes[level],
            )
            needed = int(scores.needed)
            if needed <= sizes[level]:
                return np.asarray(scores.total)[: len(poses)], np.asarray(scores.terms)[: len(poses)]
            sizes[level] = 2 ** (needed - 1).bit_length()

    def search(self, pose: Pose, problem: FrameProblem, frame: int, clock: Clock) -> tuple[Pose, np.ndarray]:
        """Sec. 4.1: root, torso, then each limb, every group starting from what the earlier ones found."""
        plan = self.tracker.search
        deviation = np.zeros(39)
        if plan is None:
            return pose, deviation
        wanted = self._wanted(pose, problem, clock)
        for number, group in enumerate(self.groups):
            if not wanted[number]:
                continue
            with clock.stage(f"search {group.name}"):
                key = jax.random.fold_in(jax.random.fold_in(self.key, frame), number)
                pose, found = self._search_group(group, plan, pose, problem, plan.wide, key)
                deviation += found
        if plan.retry is not None:
            with clock.stage("search again"):
                pose = self._search_again(plan, plan.retry, pose, problem, frame)
        return pose, deviation

    def _wanted(self, pose: Pose, problem: FrameProblem, clock: Clock) -> Bool[np.ndarray, "group"]:
        """The groups to search from this start."""
        if self.restraint is None or self.last is None:
            return np.ones(len(self.groups), bool)
        with clock.stage("calm"):
            before, after = skin(self.character, self.last[1]), skin(self.character, pose)
            moved = np.linalg.norm(np.asarray(after - before), axis=1) * self.observations.capture.fps
            speeds = np.array([np.percentile(moved[vertices], 90) for vertices in self.group_vertices])
            _, ids, _ = draw(self.character, pose, problem)
            costs = np.asarray(covered_costs(ids, problem))
            return self.restraint.search(speeds, mean_costs(self.bodies, self.face_bodies, np.asarray(ids), costs))

    def _search_again(self, plan: SearchPlan, retry: Retry, pose: Pose, problem: FrameProblem, frame: int) -> Pose:
        """Limbs that seem lost, further afield; the answer counts where it pays."""
        _, ids, _ = draw(self.character, pose, problem)
        costs = np.asarray(covered_costs(ids, problem))
        foreign = mean_costs(self.outer_bodies, self.face_bodies, np.asarray(ids), costs) > retry.foreign
        if unexplained(np.asarray(ids), problem) > retry.uncovered:
            foreign[:] = True
        for number in np.flatnonzero(foreign):
            key = jax.random.fold_in(jax.random.fold_in(self.key, frame), 100 + int(number))
            group, keys = self.far_groups[number], jax.random.split(key, retry.tries)
            found = [self._search_group(group, plan, pose, problem, retry.wide, key)[0] for key in keys]
            totals, _ = self.score(problem, pose, [pose, *found])
            best = int(np.argmin(totals[1:]))
            pose = found[best] if totals[1 + best] < totals[0] - retry.margin else pose
        return pose

    def _search_group(
        self, group: GroupSearch, plan: SearchPlan, pose: Pose, problem: FrameProblem, wide: float, key: PRNGKeyArray
    ) -> tuple[Pose, np.ndarray]:
        limb, pace = is_limb(group), self._speed_factor() if wide == 0 else 1.0
        stages = tuple(Stage(self.tracker.search_energy, *effort) for effort in plan.stages)
        sampler = plan.sampler(len(group.dofs), sigma_floor(group.dofs), 1.0 if limb else plan.trunk)
        spread = self.spread * plan.spread * pace * (1.0 if limb else plan.trunk)
        found = group(stages, sampler, self.character, pose, problem, spread, key, wide if limb else 0.0)
        return retract(self.character.skeleton, pose, found.increment), np.asarray(found.deviation)

    def _speed_factor(self) -> float:
        if not self.increments or self.last is None:
            return 1.0
        seconds = 1.0 / max(self.observations.capture.fps, 1e-3)
        speed = np.abs(self.increments[-1][6:]).max() * 0.4 / seconds
        return float(np.clip(speed, 0.5, 2.0))

    def refine(self, pose: Pose, shown: FrameImages, problem: FrameProblem, rectangle: Rectangle, clock: Clock):
        """Sec. 4.2, Eqs 8 to 10, on the increment from the last frame."""
        plan = self.tracker.refine
        if plan is None:
            return pose, None
        with clock.stage("refine"):
            base = self.last[1] if self.last is not None else pose
            prior = self._motion_prior(base, plan)
            hessian = None
            crops = [rectangle.crop(image, c) for c, image in enumerate(shown.images)]
            for round_index in range(plan.rounds):
                widen = max(1.0, plan.robust_start / 2.0**round_index)
                vertices, ids, inverse = draw(self.character, pose, problem)
                lines = contour_lines(vertices, self.character.faces, ids, inverse, problem, plan.contours)
                weights = plan.weights
                rows = [
                    Rows(
                        lines,
                        weights.residual_scale / jnp.sqrt(jnp.maximum(weights.contour, 1e-9)),
                        widen * weights.robust,
                    )
                ]
                if plan.surface_flow:
                    rows += self._surface_rows(vertices, ids, crops, shown.frame, problem, plan, widen)
                delta = difference(self.character.skeleton, base, pose)
                delta, hessian = descend(
                    self.character, base, delta, tuple(rows), (), prior, plan.refiner, steps=plan.steps
                )
                pose = retract(self.character.skeleton, base, delta)
        return pose, np.asarray(hessian) if hessian is not None else None

    def _surface_rows(
        self, vertices, ids, crops, frame: int, problem: FrameProblem, plan: RefinePlan, widen: float
    ) -> list[Rows]:
        cameras = range(problem.num_cameras)
        sources = self._selected_sources(frame)
        origins = np.asarray(problem.origins)
        for m in cameras:
            sources[m] = sources[m] + [
                Source(
                    self._padded(crops[n], origins[n]),
                    problem.intrinsics[n],
                    problem.cam_from_world[n],
                    vertices,
                    ids[n],
                    (int(origins[n, 0]), int(origins[n, 1])),
                    same_time=True,
                )
                for n in cameras
                if n != m
            ]
        flows = surface_flow(self.character, vertices, ids, crops, problem, sources, plan.flow)
        scale = plan.weights.residual_scale / jnp.sqrt(jnp.maximum(plan.weights.surface, 1e-9))
        return [Rows(lines, scale, widen * plan.weights.robust) for lines in flows]

    @staticmethod
    def _padded(crop: np.ndarray, origin: np.ndarray) -> np.ndarray:
        padded = np.zeros((crop.shape[0] + int(origin[0]), crop.shape[1] + int(origin[1]), 3), np.uint8)
        padded[int(origin[0]) :, int(origin[1]) :] = crop
        return padded

    def _motion_prior(self, base: Pose, plan: RefinePlan) -> Prior:
        limits = free_prior(self.character, base)
        if self.last is None:
            return limits
        lam = plan.weights.regularisation
        target = jnp.asarray(self._predicted(plan), jnp.float32)
        unit = jnp.concatenate([jnp.full(3, 2.0), jnp.ones(36)])
        return limits._replace(l1=lam * unit, weight=lam * plan.weights.prior * unit**2, target=target)

    def _predicted(self, plan: RefinePlan) -> np.ndarray:
        if not self.increments:
            return np.zeros(39)
        window = np.zeros((30, 39), np.float32)
        recent = np.stack(self.increments[-30:])
        window[-len(recent) :] = recent
        return np.asarray(predict_difference(jnp.asarray(window), len(recent), plan.autoregression))

    # The frame --------------------------------------------------------------------------------------------------

    def first(self, shown: FrameImages, pose: Pose) -> FrameResult:
        """Take a registered pose as the answer of a frame, at which a sequence starts."""
        self.observations.restart()
        clock = Clock()
        problem, _ = self._problem(shown, pose, np.zeros(len(shown.images)), clock)
        return self._finish(shown, problem, pose, np.zeros(39), None, clock)

    def track(self, shown: FrameImages) -> FrameResult:
        """Find the pose of the next frame: flow start, search, refinement."""
        assert self.last is not None
        clock = Clock()
        previous = self.last[1]
        start, speed = (
            self.flow_start(shown, clock) if self.tracker.flow_start else (previous, np.zeros(len(shown.images)))
        )
        problem, rectangle = self._problem(shown, start, speed, clock)
        candidates = [previous, start]
        if shown.frame in self.observations.key_poses:
            candidates.append(self.observations.key_poses[shown.frame])
        with clock.stage("score"):
            totals, _ = self.score(problem, previous, candidates)
        pose = candidates[int(np.argmin(totals))]
        pose, deviation = self.search(pose, problem, shown.frame, clock)
        if self.tracker.polish is not None:
            with clock.stage("polish"):
                pose, _, _ = polish(self.tracker.search_energy, self.character, pose, problem, self.tracker.polish)
        pose, hessian = self.refine(pose, shown, problem, rectangle, clock)
        return self._finish(shown, problem, pose, deviation, hessian, clock)

    def _problem(self, shown: FrameImages, pose: Pose, speed, clock: Clock) -> tuple[FrameProblem, Rectangle]:
        with clock.stage("background"):
            vertices = np.asarray(skin(self.character, pose))
            self.rectangle = frame_rectangle(vertices, self.cameras, shown.frame, self.rectangle, speed)
            edges = self.tracker.refine.edges if self.tracker.refine is not None else "canny"
            return self.observations.problem(shown, self.rectangle, pose, edges), self.rectangle

    def _finish(
        self, shown: FrameImages, problem: FrameProblem, pose: Pose, deviation, hessian, clock: Clock
    ) -> FrameResult:
        with clock.stage("score"):
            _, terms = self.score(problem, pose, [pose])
            _, ids, _ = draw(self.character, pose, problem)
            costs = covered_costs(ids, problem)
            moved = difference(self.character.skeleton, self.last[1], pose) if self.last is not None else jnp.zeros(39)
            seconds = abs(shown.timestamp - self.last[0].timestamp) if self.last is not None else 1.0
            speed = float(jnp.linalg.norm(moved[:3])) / max(seconds, 1e-3)
            if self.restraint is not None:
                costs_by_group = mean_costs(self.bodies, self.face_bodies, np.asarray(ids), np.asarray(costs))
                self.restraint.learn(costs_by_group)
            verdict = judge(
                self.character,
                self.face_bodies,
                np.asarray(ids),
                np.asarray(costs),
                speed,
                self.tracker.verdict,
                unexplained(np.asarray(ids), problem),
            )
        names = [term.name for term in self.tracker.search_energy.terms]
        if self.last is not None:
            self.increments = [*self.increments, np.asarray(moved)][-30:]
        self.last = (shown, pose)
        with clock.stage("background"):
            assert self.rectangle is not None
            self.observations.learn(shown, self.rectangle, pose)
        energy = {name: float(value) for name, value in zip(names, terms[0], strict=True)}
        energy["covered"] = verdict.covered_cost
        return FrameResult(
            shown.frame,
            shown.timestamp,
            pose,
            energy,
            verdict.confidence,
            verdict.status,
            deviation,
            hessian,
            clock.seconds,
        )
