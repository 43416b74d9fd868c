"""Settings by name."""

import inspect
from dataclasses import fields, is_dataclass
from typing import get_args, get_type_hints

import jax.numpy as jnp
import pytest

from jaxmocap._results import InputError
from jaxmocap.appearance import AppearanceSettings
from jaxmocap.clip import ClipPlan
from jaxmocap.energies import Keypoints
from jaxmocap.refinement import FlowSettings
from jaxmocap.refiners import Shooting
from jaxmocap.render import SoftSettings
from jaxmocap.samplers import CrossEntropy, InteractingSimulatedAnnealing, RandomSearch
from jaxmocap.search import PolishPlan, Retry, SearchPlan
from jaxmocap.track import BackwardSearch, Tracker, with_settings
from jaxmocap.verdict import UncertaintySettings

NORMAL = Tracker.preset("normal")


def records(part, kind=None):
    """The settings records of a part and of all below it, those that are off switched on."""
    if part is None:
        part = next((one() for one in get_args(kind) if is_dataclass(one)), None)
    if isinstance(part, tuple):
        return [found for one in part for found in records(one)]
    if not is_dataclass(part):
        return []
    kinds = get_type_hints(type(part))
    return [type(part), *(one for f in fields(part) for one in records(getattr(part, f.name), kinds[f.name]))]


def test_every_setting_is_explained():
    """`--set` reaches each of them: it has a line of its own where its record is explained."""
    parts = [NORMAL, *(kind() for kind in (CrossEntropy, RandomSearch, Shooting, Keypoints))]
    known = {record for part in parts for record in records(part)}
    assert {Tracker, Retry, PolishPlan, SoftSettings, FlowSettings, ClipPlan} < known
    unsaid = [
        f"{record.__name__}.{field.name}"
        for record in known
        for field in fields(record)
        if f"\n    {field.name}: " not in inspect.cleandoc(record.__doc__ or "")
    ]
    assert unsaid == []


def test_a_plan_that_is_off_is_turned_on_and_changed_by_name():
    hybrid = with_settings(NORMAL, {"detections": "on", "detections.search.weight": "3", "detections.weight": "0.2"})
    assert NORMAL.detections is None
    assert float(hybrid.detections.search.weight) == 3
    assert hybrid.detections.weight == 0.2


def test_parts_are_switched_off_and_on():
    off = with_settings(NORMAL, {"search.gating": "off", "search.retry": None})
    assert off.search.gating is None
    assert off.search.retry is None
    on = with_settings(off, {"search.retry": "on", "polish": "on"})
    assert on.search.retry == Retry()
    assert on.polish is not None
    given = with_settings(NORMAL, {"backward_search": BackwardSearch(longest=2)})
    assert given.backward_search.longest == 2
    assert NORMAL.search.gating is not None


def test_what_is_on_keeps_its_settings():
    changed = with_settings(NORMAL, {"search.retry.tries": "7", "search.retry": "on"})
    assert changed.search.retry.tries == 7


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("search.particles", "64", 64),
        ("search.particles", "off", None),
        ("search.trunk", "0.25", 0.25),
        ("search.iterations", "20", 20),
        ("search.faces", "1", 1.0),
        ("refine.rounds", "3", 3),
        ("refine.surface_flow", "false", False),
        ("refine.autoregression", "velocity", "velocity"),
        ("search_energy.terms.view_view.fail", "tau", "tau"),
        ("angles", "same", "same"),
        ("flow.preset", "fast", "fast"),
    ],
)
def test_text_becomes_the_kind_of_the_setting(name, text, value):
    found = with_settings(NORMAL, {name: text})
    for step in name.split("."):
        listed = (
            {getattr(entry, "name", str(i)): entry for i, entry in enumerate(found)} if type(found) is tuple else {}
        )
        found = listed[step] if listed else getattr(found, step)
    assert found == value
    assert type(found) is type(value)


def test_a_sampler_or_a_refiner_is_chosen_and_changed_by_name():
    changed = with_settings(NORMAL, {"sampler.survival": "0.5", "sampler.answer": "mean"})
    assert float(changed.sampler.survival) == 0.5
    assert changed.sampler.answer == "mean"
    other = with_settings(NORMAL, {"sampler": "CrossEntropy", "sampler.smoothing": "0.1", "refine.refiner": "Shooting"})
    assert isinstance(other.sampler, CrossEntropy)
    assert float(other.sampler.smoothing) == pytest.approx(0.1)
    assert isinstance(other.refine.refiner, Shooting)
    assert with_settings(NORMAL, {"sampler": RandomSearch(shrink=0.5)}).sampler.shrink == 0.5


def test_weights_are_array_leaves():
    changed = with_settings(NORMAL, {"search_energy.terms.view_view.weight": "0.5", "refine.weights.prior": 2})
    assert changed.search_energy.terms[1].weight.dtype == jnp.float32
    assert float(changed.search_energy.terms[1].weight) == 0.5
    assert float(changed.refine.weights.prior) == 2.0


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("serach.gating", "off", "there is no 'serach'; choose one of search_energy, search, refine"),
        ("search.speed", "1", "there is no 'speed'; choose one of step, iterations, faces, particles"),
        (
            "search_energy.terms.colour.weight",
            "1",
            "there is no 'colour'; choose one of model_view, view_view, posture",
        ),
        ("search.trunk", "much", "is 'much', but a number from 0 was expected"),
        ("search.trunk", "off", "is 'off', but a number from 0 was expected"),
        ("search.trunk", "-0.5", "is '-0.5', but a number from 0 was expected"),
        ("search.prior", "nan", "is 'nan', but a number from 0 was expected"),
        ("refine.weights.robust", -1.0, "is -1.0, but a number from 0 was expected"),
        ("refine.rounds", "2.5", "is '2.5', but a whole number from 0 was expected"),
        ("search.retry.tries", "-1", "is '-1', but a whole number from 0 was expected"),
        ("flow.preset", "slow", "is 'slow', but ultrafast or fast or medium was expected"),
        ("search.iterations", "inf", "is 'inf', but a whole number from 0 was expected"),
        ("search.step", "3", "every pixel, every second or every fourth .1, 2, 4., not 3"),
        ("search_energy.terms.view_view.step", "3", "every step-th pixel, 1, 2, 4 or 8, not 3"),
        ("refine.steps", "0", "one round of one step at least, not 4 of 0"),
        ("refine.surface_flow", "maybe", "true or false was expected"),
        ("polish.steps", "3", "what comes before 'steps' is off"),
        ("search.trunk.deeper", "3", "has no parts"),
        ("sampler.num_particles", "500", "the search sizes its sampler for every group; set search.particles"),
        ("sampler.num_iterations", "9", "the search sizes its sampler for every group; set search.iterations"),
        ("sampler.sigma_min", "0.1", "the floors are 2 mm and 0.25 degrees"),
        ("sampler", "Annealing", "is 'Annealing', but .*CrossEntropy or "),
        ("search.retry", "5", r"is '5', but on \(a Retry\) or off was expected"),
    ],
)
def test_a_mistake_gets_one_sentence(name, value, sentence):
    with pytest.raises(InputError, match=sentence):
        with_settings(NORMAL, {name: value})


def test_a_search_of_the_whole_body_needs_a_number_of_particles():
    with pytest.raises(InputError, match="number of particles"):
        SearchPlan(groups="whole")
    plan = SearchPlan(groups="whole", particles=300, iterations=7)
    sampler = plan.sized(InteractingSimulatedAnnealing(), tuple(range(39)))
    assert (sampler.num_particles, sampler.num_iterations) == (300, 7)


def test_any_record_of_settings_can_be_changed():
    settings = with_settings(AppearanceSettings(), {"behind": "none", "grid.rows": "12"})
    assert (settings.behind, settings.grid.rows, settings.grid.columns) == ("none", 12, 16)
    assert with_settings(UncertaintySettings(), {"doubt": "5"}) == UncertaintySettings(doubt=5.0)
    alphas = with_settings(settings, {"warp.alphas.1": "50"}).warp.alphas
    assert alphas == (settings.warp.alphas[0], 50.0, *settings.warp.alphas[2:])
    with pytest.raises(InputError, match="there is no '7'; choose one of 0, 1, 2, 3"):
        with_settings(settings, {"warp.alphas.7": "1"})
