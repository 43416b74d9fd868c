"""Refiners times properties: a new refiner joins by a line in `REFINERS`."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares, minimize

from jaxmocap._results import InputError
from jaxmocap.refiners import LeastSquares, RefineProblem, Shooting

REFINERS = {
    "shooting": Shooting(),
    "levenberg marquardt": LeastSquares(),
    "dogleg": LeastSquares(method="dogleg"),
}
refine = eqx.filter_jit(lambda refiner, problem, start: refiner.refine(problem, start))


@pytest.fixture(
    params=[pytest.param(r, marks=pytest.mark.slow if name == "dogleg" else []) for name, r in REFINERS.items()],
    ids=REFINERS.keys(),
)
def refiner(request):
    return request.param


class Curved(eqx.Module):
    """`scale (A x + 0.3 sin(B x)^2) - y`: a nonlinear residual with a known sparse origin."""

    a: jax.Array
    b: jax.Array
    y: jax.Array
    scale: float = eqx.field(static=True, default=1.0)

    def __call__(self, x):
        straight, bent = (jnp.matmul(rows, x, precision="highest") for rows in (self.a, self.b))
        return self.scale * (straight + 0.3 * jnp.sin(bent) ** 2) - self.y


def curved(rows=60, size=6, noise=0.1, seed=0, scale=1.0):
    rng = np.random.default_rng(seed)
    a, b = (jnp.asarray(rng.normal(size=(rows, size))) for _ in range(2))
    truth = jnp.asarray(np.where(rng.random(size) < 0.5, 0.0, 0.3 * rng.normal(size=size)))
    clean = Curved(a, b, jnp.zeros(rows), scale)
    return Curved(a, b, clean(truth) + noise * jnp.asarray(rng.normal(size=rows)), scale)


def problem_of(residual, size=6, limit=1.0, **options):
    zero = jnp.zeros(size)
    return RefineProblem(residual, zero, zero - limit, zero + limit, **options)


def test_optimality_conditions_hold_on_the_nonlinear_problem_of_39_dofs():
    found = refine(Shooting(), problem_of(curved(400, 39, 0.05, scale=0.3), 39), jnp.zeros(39))
    assert found.stationarity < 1e-8
    assert found.converged
    assert 0 < jnp.sum(found.value == 0) < 39
    assert jnp.all(jnp.diff(found.history) <= 1e-12)


@pytest.mark.parametrize("method", ["levenberg_marquardt", "dogleg"])
def test_shooting_and_optimistix_agree_on_the_nonlinear_problem_of_39_dofs(method):
    problem = problem_of(curved(400, 39, 0.05, scale=0.3), 39)
    exact = refine(Shooting(), problem, jnp.zeros(39))
    smoothed = refine(LeastSquares(method=method), problem, jnp.zeros(39))
    np.testing.assert_allclose(smoothed.value, exact.value, atol=2e-4)
    np.testing.assert_array_equal(smoothed.value == 0, exact.value == 0)
    np.testing.assert_allclose(smoothed.objective, exact.objective, rtol=1e-5)
    assert smoothed.converged


def test_optimality_measure_sees_a_wrong_threshold():
    """The classic slip by a factor of two in the L1 is caught by the conditions."""
    problem = problem_of(curved())
    slipped = eqx.tree_at(lambda p: p.l1, problem, 2 * problem.l1)
    found = refine(Shooting(), slipped, jnp.zeros(6))
    assert problem.stationarity(found.value) > 0.1


def test_without_l1_and_prior_it_is_ordinary_least_squares(refiner):
    residual = curved()
    found = refine(refiner, problem_of(residual, l1=0.0, prior_weight=0.0), jnp.zeros(6))
    expected = least_squares(lambda x: np.asarray(residual(jnp.asarray(x))), np.zeros(6), xtol=1e-14, ftol=1e-14).x
    np.testing.assert_allclose(found.value, expected, atol=1e-5)


def test_prior_alone_is_reached_and_is_shrunk_by_the_l1(refiner):
    prior = jnp.array([0.5, -0.3, 0.0])
    wide = jnp.full(3, 2.0)
    problem = RefineProblem(lambda x: 0 * x, prior, -wide, wide, l1=0.0, prior_weight=3.0)
    np.testing.assert_allclose(refine(refiner, problem, jnp.zeros(3)).value, prior, atol=1e-5)
    problem = eqx.tree_at(lambda p: p.l1, problem, jnp.asarray(1.2))
    np.testing.assert_allclose(refine(refiner, problem, jnp.zeros(3)).value, [0.3, -0.1, 0.0], atol=5e-4)


def test_active_limits_are_respected_and_optimal(refiner):
    problem = problem_of(curved(), limit=0.05)
    found = refine(refiner, problem, jnp.zeros(6))
    assert jnp.any(jnp.abs(found.value) == 0.05)
    assert jnp.all(jnp.abs(found.value) <= 0.05)
    exact = refine(Shooting(), problem, jnp.zeros(6))
    assert exact.stationarity < 1e-8
    np.testing.assert_allclose(found.value, exact.value, atol=1e-3)


def test_subject_at_rest_gives_exact_zeros(refiner):
    residual = curved(noise=0.0)
    at_rest = Curved(residual.a, residual.b, 1e-3 * jnp.sin(jnp.arange(60.0)))
    for start in (jnp.zeros(6), jnp.full(6, 0.02)):
        np.testing.assert_array_equal(refine(refiner, problem_of(at_rest), start).value, jnp.zeros(6))


def test_start_outside_the_box_is_brought_inside(refiner):
    found = refine(refiner, problem_of(curved(), limit=0.1), jnp.full(6, 5.0))
    assert jnp.all(jnp.abs(found.value) <= 0.1)


def test_squared_problem_equals_scipy_with_split_variables():
    residual = curved()
    found = refine(Shooting(), problem_of(residual, l1=1.0, prior_weight=0.5), jnp.zeros(6))

    def split(x):
        delta = x[:6] - x[6:]
        e = np.asarray(residual(jnp.asarray(delta)))
        return e @ e + np.sum(x) + 0.5 * delta @ delta

    expected = minimize(split, np.zeros(12), bounds=[(0, 1)] * 12, options={"ftol": 1e-15, "gtol": 1e-9})
    np.testing.assert_allclose(found.objective, expected.fun, rtol=1e-7)
    np.testing.assert_allclose(found.value, expected.x[:6] - expected.x[6:], atol=1e-4)


@pytest.mark.parametrize("refiner", [Shooting(reweights=60), LeastSquares(reweights=60)], ids=["shooting", "lm"])
def test_printed_norms_equal_scipy(refiner):
    residual = curved()
    problem = problem_of(residual, l1=2.0, prior_weight=1.0, norm="l2", group_size=3, residual_floor=0.02)
    found = refine(refiner, problem, jnp.zeros(6))

    @jax.jit
    def split(x):
        delta = x[:6] - x[6:]
        still = 2 * jnp.sum(jnp.abs(delta))
        return problem.objective(delta) - still + 2 * jnp.sum(x)

    expected = minimize(split, np.zeros(12), bounds=[(0, 1)] * 12, options={"ftol": 1e-15, "gtol": 1e-9})
    np.testing.assert_allclose(found.objective, expected.fun, rtol=1e-4)
    np.testing.assert_allclose(found.value, expected.x[:6] - expected.x[6:], atol=2e-3)
    assert jnp.all(jnp.diff(found.history) <= 1e-4 * found.objective)


def test_printed_norms_ignore_an_outlier_that_squares_follow():
    target = jnp.concatenate([jnp.full(40, 0.2), jnp.full(5, 20.0)])
    results = {}
    for norm in ("squared", "l2"):
        problem = RefineProblem(
            lambda x: x[0] - target, jnp.zeros(1), -jnp.full(1, 9.0), jnp.full(1, 9.0), 0.0, 0.0, norm=norm
        )
        results[norm] = refine(Shooting(reweights=30), problem, jnp.zeros(1)).value[0]
    np.testing.assert_allclose(results["squared"], jnp.mean(target), rtol=1e-6)
    np.testing.assert_allclose(results["l2"], 0.2, atol=0.01)


def test_given_jacobian_is_used_and_gives_the_same_result(refiner):
    residual, calls = curved(), []

    def jacobian(x):
        calls.append(x.shape)
        return jax.jacrev(residual)(x)

    plain = refine(refiner, problem_of(residual), jnp.zeros(6))
    own = refine(refiner, problem_of(residual, jacobian=jacobian), jnp.zeros(6))
    assert calls
    np.testing.assert_allclose(own.value, plain.value, atol=1e-6)


def test_mapping_over_the_l1_weight_equals_a_loop(refiner):
    residual, weights = curved(), jnp.array([0.0, 1.0, 30.0])
    solve = jax.jit(lambda l1: refiner.refine(problem_of(residual, l1=l1), jnp.zeros(6)))
    mapped = jax.jit(jax.vmap(solve))(weights)
    assert mapped.converged.shape == mapped.steps.shape == (3,)
    for index, l1 in enumerate(weights):
        np.testing.assert_allclose(mapped.value[index], solve(l1).value, atol=1e-5)


def test_residual_that_is_not_a_number_returns_the_start_and_says_so(refiner):
    found = refine(refiner, problem_of(lambda x: jnp.full(4, jnp.nan) * x[0]), jnp.full(6, 0.1))
    np.testing.assert_array_equal(found.value, jnp.full(6, 0.1))
    assert not found.converged


def test_other_numbers_and_other_data_do_not_compile_again():
    traces = []

    class Counting(eqx.Module):
        inner: Curved

        def __call__(self, x):
            traces.append(x.shape)
            return self.inner(x)

    refine(Shooting(), problem_of(Counting(curved())), jnp.zeros(6))
    seen = len(traces)
    refine(Shooting(damping=0.1), problem_of(Counting(curved(seed=3)), l1=1.0), jnp.zeros(6) + 0.1)
    assert len(traces) == seen


def test_single_precision_reaches_the_same_result():
    residual = curved()
    exact = refine(Shooting(), problem_of(residual), jnp.zeros(6)).value
    with jax.enable_x64(False):
        single = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), jnp.float32), residual)
        found = refine(Shooting(), problem_of(single), jnp.zeros(6))
        assert found.value.dtype == jnp.float32
        assert found.converged
        np.testing.assert_allclose(found.value, exact, atol=1e-5)


def test_a_start_of_single_precision_goes_on_in_that_of_the_problem(refiner):
    residual = curved()
    found = refine(refiner, problem_of(residual), jnp.zeros(6, jnp.float32)).value
    assert found.dtype == jnp.float64
    np.testing.assert_array_equal(found, refine(refiner, problem_of(residual), jnp.zeros(6)).value)


def test_unknown_names_are_refused():
    with pytest.raises(InputError, match="norm is 'l3'"):
        problem_of(curved(), norm="l3")
    with pytest.raises(InputError, match="method is 'newton'"):
        LeastSquares(method="newton")
