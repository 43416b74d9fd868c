"""The derivative of a minimum against formulas, and against finding it anew."""

import re
from functools import partial
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.experiments import newton, sensitivity


def test_the_minimum_of_a_quadratic_moves_as_the_formula_says():
    shape = jnp.array([[2.0, 0.5], [0.5, 1.0]])
    pull = jnp.array([[1.0, 2.0, 0.0], [0.0, -1.0, 3.0]])
    product = partial(jnp.matmul, precision="highest")
    objective = lambda x, s: product(x, 0.5 * product(shape, x) - product(pull, s))  # noqa: E731
    setting = jnp.array([0.3, -0.2, 1.0])
    minimum = jnp.linalg.solve(shape, product(pull, setting))
    found = sensitivity(objective, minimum, setting)
    np.testing.assert_allclose(found.slope, jnp.linalg.solve(shape, pull), rtol=1e-5)
    np.testing.assert_allclose(found.gradient, 0.0, atol=1e-5)
    np.testing.assert_allclose(found.curvature, jnp.linalg.eigvalsh(shape), rtol=1e-5)


def test_it_agrees_with_finding_the_minimum_anew():
    def objective(x, s):
        return jnp.sum(jnp.cosh(x - s * jnp.array([1.0, -2.0]))) + 0.1 * s * jnp.sum(x**4)

    setting, step = jnp.array(0.4), 0.02
    minimum = newton(objective, jnp.zeros(2), setting)
    found = sensitivity(objective, minimum, setting).slope
    above, below = (newton(objective, minimum, setting + sign * step) for sign in (1, -1))
    np.testing.assert_allclose(found, (above - below) / (2 * step), rtol=5e-3)


def test_a_direction_the_objective_does_not_see_stays_where_it_is():
    found = sensitivity(lambda x, s: (x[0] - 3 * s) ** 2 + 0 * x[1], jnp.array([3.0, 7.0]), jnp.array(1.0))
    np.testing.assert_allclose(found.slope, [3.0, 0.0], atol=1e-6)


def test_newton_goes_downhill_from_a_hill_top():
    found = newton(lambda x, s: (x[0] ** 2 - s) ** 2, jnp.array([0.05]), jnp.array(1.0))
    assert float(abs(found[0])) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.slow
def test_how_far_a_camera_s_error_moves_the_pose(world):
    """The example of docs/experiments.md: keypoints without error, a camera that is shifted and turned."""
    names = {"character": world.character, "pose": world.pose(2), "view": world.cameras.at(2)}
    names["keypoints"] = jnp.asarray(world.keypoints(2), jnp.float32)
    text = (Path(__file__).parents[2] / "docs" / "experiments.md").read_text()
    block = next(b for b in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if "def objective" in b)
    exec(compile(block, "docs/experiments.md", "exec"), names)
    objective, minimum, moved = names["objective"], names["minimum"], names["moved"]
    assert np.abs(moved.gradient).max() < 1e-3 * np.abs(moved.curvature).max()
    assert moved.curvature.min() > 0
    for entry, step in ((0, 0.01), (4, 0.004)):
        twist = step * jnp.eye(6)[entry]
        above, below = (newton(objective, minimum, sign * twist) for sign in (1, -1))
        anew = (above - below) / (2 * step)
        np.testing.assert_allclose(moved.slope[:, entry], anew, atol=0.05 * float(jnp.abs(anew).max()))
    assert names["wrist_per_degree"] > 0
