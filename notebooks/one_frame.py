"""One frame of the synthetic dancer as the tracker sees it: what the notebooks on energies and gradients begin with."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp

import jax
import jax.numpy as jnp
import numpy as np

import jaxmocap as jm
from jaxmocap.energies import GroupProblem, Scores, SearchEnergy, body_part, prepare_base, score_particles
from jaxmocap.observation import FrameProblem
from jaxmocap.synthetic import make_capture, write_capture

WINDOWS = 8192


@dataclass(frozen=True, eq=False)
class OneFrame:
    """The character, the true pose of a frame that is not selected, and its `problem`: images, colours, cameras."""

    character: jm.Character
    pose: jm.Pose
    problem: FrameProblem
    image: np.ndarray

    def scores(self, energy: SearchEnergy, group: str) -> Callable[[jax.Array], Scores]:
        """Scores of particles (particle, dof): increments of one group, such as "l_arm", from the true pose."""
        dofs = self.character.skeleton.group(group)
        part = body_part(self.character, dofs)
        particles_of = GroupProblem(self.character, part, self.pose, self.problem)
        base = prepare_base(energy, particles_of, WINDOWS)

        def score(particles: jax.Array) -> Scores:
            increments = jnp.zeros((len(particles), 39)).at[:, jnp.array(dofs)].set(particles)
            return score_particles(energy, particles_of, base, increments, WINDOWS)

        return score


def one_frame(frame: int = 2, size: tuple[int, int] = (320, 180)) -> OneFrame:
    """Film three frames, learn the appearance at the selected ones (0 and 1), and look at another one."""
    truth = make_capture(3, size, sensor_noise=0.0)
    capture = jm.Capture.open(write_capture(truth, Path(mkdtemp()) / "capture"))
    poses = {selected: truth.pose(selected) for selected in truth.selected_frames}
    cameras, character = truth.cameras, truth.character
    appearance = jm.fit_capture_appearance(capture, cameras, character, poses, key=jax.random.key(0))
    observations = jm.observe(capture, cameras, character, appearance, poses)
    pose = truth.pose(frame)
    seen = observations.at(frame, pose)
    return OneFrame(character, pose, seen.problem, seen.shown.images[0])
