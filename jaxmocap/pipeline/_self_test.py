"""A self-test of some seconds: on a small synthetic world every answer is known."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmocap._types import Report
from jaxmocap.capture import FrameReader, index_video
from jaxmocap.character import Pose, retract, skin
from jaxmocap.energies import (
    GroupProblem,
    ModelView,
    SearchEnergy,
    body_part,
    prepare_base,
    score_particles,
    soft_score,
)
from jaxmocap.geometry import intersection_over_union
from jaxmocap.observation import FrameProblem, build_problem, place_rectangle, projected_box, surface_of
from jaxmocap.render import SoftSettings, face_ids
from jaxmocap.samplers import CrossEntropy, run as run_search
from jaxmocap.synthetic import SyntheticCapture, make_capture
from jaxmocap.viewers import write_overlay_video

_SIZE = (192, 108)
_OFF = 0.06  # metres sideways, from where the gradient is taken and the search begins
_WINDOWS = 4096
_PARTICLES = 32
_SOFT = SoftSettings(1.0, 12, 4096, 4096, 16384)


@dataclass(frozen=True)
class SelfTest:
    """One step of the self-test: what came out, in words, and whether that is the known answer."""

    name: str
    passed: bool
    said: str
    seconds: float


def self_test(progress: Report | None = None) -> list[SelfTest]:
    """Film a body with two cameras; draw it, score it, differentiate the score, search for it, and write and read a
    video. A step that raises has failed, and the others still run. `progress` hears of "self-test"."""
    world = _World()
    steps = {
        "render": world.render,
        "energy": world.energy_of_truth,
        "gradient": world.gradient,
        "search": world.search,
        "video": world.video,
    }
    tell = progress or (lambda stage, done, total: None)
    tell("self-test", 0, len(steps))
    done = []
    for name, step in steps.items():
        done.append(_timed(name, step))
        tell("self-test", len(done), len(steps))
    return done


def _timed(name: str, step: Callable[[], tuple[bool, str]]) -> SelfTest:
    begin = time.perf_counter()
    try:
        passed, said = step()
    except Exception as error:  # whatever a broken installation raises is the answer
        passed, said = False, f"{type(error).__name__}: {error}"
    return SelfTest(name, bool(passed), said, time.perf_counter() - begin)


class _World:
    """One frame of two views. The body explains every pixel it covers and the background every other (Eq. 6), so the
    energy is least at the true pose."""

    @cached_property
    def truth(self) -> SyntheticCapture:
        return make_capture(1, _SIZE, sensor_noise=0.0)

    @cached_property
    def pose(self) -> Pose:
        return self.truth.pose(0)

    @cached_property
    def problem(self) -> FrameProblem:
        truth, view = self.truth, self.truth.cameras.at(0)
        vertices = np.asarray(skin(truth.character, self.pose))
        boxes = [
            projected_box(vertices, np.asarray(k), np.asarray(t))
            for k, t in zip(view.intrinsics, view.cam_from_world, strict=True)
        ]
        rectangle = place_rectangle(
            np.stack([box for box in boxes if box is not None]), np.zeros(2), truth.cameras.sizes
        )
        foreign = [rectangle.crop(mask.astype(np.float32), camera) for camera, mask in enumerate(truth.masks[0])]
        labels = [np.zeros((rectangle.height, rectangle.width), int)] * 2
        surface = surface_of(truth.character, None, 2)
        surface = replace(surface, colour_distance=jnp.zeros_like(surface.colour_distance))
        images = list(truth.images[0])
        return build_problem(images, rectangle, truth.cameras, 0, vertices, surface, labels, foreign)

    @cached_property
    def scores(self) -> Callable:
        """Eq. 6 of particles that move the whole body, (particle, 3) metres."""
        energy, character = SearchEnergy((ModelView(),)), self.truth.character
        part = body_part(character, character.skeleton.group("root"))
        group = GroupProblem(character, part, self.pose, self.problem)

        @eqx.filter_jit
        def score(moves: Float[Array, "particle 3"]) -> Float[Array, "particle"]:
            base = prepare_base(energy, group, 16)
            increments = jnp.zeros((len(moves), character.skeleton.num_dofs)).at[:, :3].set(moves)
            return score_particles(energy, group, base, increments, _WINDOWS).total

        return score

    def render(self) -> tuple[bool, str]:
        truth, view = self.truth, self.truth.cameras.at(0)
        vertices = skin(truth.character, self.pose)
        origins = jnp.zeros((2, 2), jnp.int32)
        width, height = _SIZE
        faces = truth.character.faces
        ids, _ = face_ids(vertices, faces, view.intrinsics, view.cam_from_world, origins, height, width)
        drawn, true = np.asarray(ids) >= 0, truth.masks[0]
        overlap = float(intersection_over_union(drawn, true).min())
        return overlap > 0.95, f"the drawn body overlaps with its true masks by {100 * overlap:.1f} %"

    def energy_of_truth(self) -> tuple[bool, str]:
        moves = jnp.zeros((_PARTICLES, 3)).at[1, 0].set(_OFF)  # as many as the search scores: one program for both
        there, away = np.asarray(self.scores(moves)[:2])
        return there < 0.5 * away, f"{there:.3f} at the true pose, {away:.3f} where it is {100 * _OFF:.0f} cm off"

    def gradient(self) -> tuple[bool, str]:
        energy, truth = SearchEnergy((ModelView(),)), self.truth
        skeleton = truth.character.skeleton

        @jax.jit
        def value_and_slope(move: Float[Array, "3"]) -> tuple[Float[Array, ""], Float[Array, "3"]]:
            def value(move: Float[Array, "3"]) -> Float[Array, ""]:
                moved = retract(skeleton, self.pose, jnp.zeros(skeleton.num_dofs).at[:3].set(move))
                return soft_score(energy, truth.character, moved, self.problem, _SOFT).total

            return jax.value_and_grad(value)(move)

        place, steps = jnp.array([_OFF, 0.0, 0.0]), 0.004 * jnp.eye(3)
        slope = np.asarray(value_and_slope(place)[1])
        pairs = [(value_and_slope(place + step)[0], value_and_slope(place - step)[0]) for step in steps]
        quotient = np.array([float(after - before) for after, before in pairs]) / 0.008
        cosine = float(slope @ quotient / np.linalg.norm(slope) / np.linalg.norm(quotient))
        said = f"slope {slope[0]:.3f} per metre, {quotient[0]:.3f} by differences; cosine of the two {cosine:.3f}"
        alike = cosine > 0.95 and 0.7 < float(np.linalg.norm(slope) / np.linalg.norm(quotient)) < 1.3
        return bool(slope[0] > 0) and alike, said

    def search(self) -> tuple[bool, str]:
        sampler = CrossEntropy(num_particles=_PARTICLES, num_iterations=6, elites=8 / _PARTICLES)
        limit = jnp.full(3, 0.2)
        start = jnp.array([_OFF, 0.0, 0.0])
        found, _ = run_search(sampler, self.scores, start, 0.25 * limit, -limit, limit, jax.random.key(0))
        error = 100 * float(jnp.linalg.norm(found))
        return error < 50 * _OFF, f"from {100 * _OFF:.0f} cm off the search ends {error:.1f} cm off"

    def video(self) -> tuple[bool, str]:
        grey = [np.full((64, 96, 3), value, np.uint8) for value in (40, 120, 200)]
        with TemporaryDirectory() as folder:
            times = enumerate(grey)
            path = write_overlay_video(Path(folder) / "test.mp4", [(t / 30, image) for t, image in times])
            reader = FrameReader(index_video(path))
            read = [float(reader.read(number).mean()) for number in (2, 0, 1)]
            reader.close()
        right = np.allclose(read, (200, 40, 120), atol=4)
        return (
            right,
            "H.264 was written, and its frames were found by their times" if right else f"greys came as {read}",
        )
