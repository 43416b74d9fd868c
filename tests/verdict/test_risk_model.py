"""How likely a mistake is: what looks worse is never trusted more, and a fit finds what a known world was made of."""

from pathlib import Path

import numpy as np
import pytest

from jaxmocap.verdict._model import FRAME_MODEL, LIMB_MODEL, probability

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.mark.parametrize("model", [FRAME_MODEL, LIMB_MODEL])
def test_what_looks_worse_is_not_trusted_more(model):
    assert len(model.names) == len(model.weights) == len(model.usual)
    usual = np.array([model.usual])
    assert probability(model.logit(usual))[0] < 0.2
    assert (model.logit(usual + 0.3 * np.eye(len(model.names))) >= model.logit(usual)).all()


@pytest.mark.parametrize("model", [FRAME_MODEL, LIMB_MODEL])
def test_reasons_add_up_to_what_is_beyond_the_usual(model):
    usual = np.array([model.usual])
    features = usual + np.linspace(0.0, 0.1, len(model.names))
    parts = sum(model.reasons(features).values())
    np.testing.assert_allclose(parts, model.logit(features) - model.logit(usual), atol=1e-9)


def test_nothing_is_surer_than_one_in_a_thousand():
    extreme = probability(FRAME_MODEL.logit(np.stack([np.full(len(FRAME_MODEL.names), v) for v in (-1e3, 1e3)])))
    np.testing.assert_allclose(extreme, [0.0009, 0.9991], atol=1e-4)


def test_the_fit_finds_the_weights_of_a_known_world(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    from verdict_fit import fitted

    rng, weights = np.random.default_rng(0), np.array([3.0, 0.0, 1.5])
    features = rng.standard_normal((20000, 3))
    wrong = rng.random(20000) < probability(-1.0 + features @ weights)
    model = fitted(("a", "b", "c"), features, wrong, np.ones(20000), ridge=0.0)
    np.testing.assert_allclose(model.weights, weights, atol=0.15)
    assert model.intercept == pytest.approx(-1.0, abs=0.1)


def test_stretching_finds_how_much_too_sure_a_model_is(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    from verdict_fit import stretched

    rng = np.random.default_rng(1)
    features = rng.standard_normal((20000, len(FRAME_MODEL.names)))
    logit = FRAME_MODEL.logit(features)
    wrong = rng.random(20000) < probability(0.3 + 0.5 * logit)
    model = stretched(FRAME_MODEL, logit, wrong, np.ones(20000))
    np.testing.assert_allclose(model.weights, 0.5 * np.array(FRAME_MODEL.weights), rtol=0.05)
    assert model.intercept == pytest.approx(0.3 + 0.5 * FRAME_MODEL.intercept, abs=0.1)
