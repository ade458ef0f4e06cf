"""Arms of a comparison, as the command line names them."""

import pytest

from avrare.analysis.compare.estimator_options import parse_arms, split_settings
from avrare.base.errors import AvrareError, PluginError, UsageError
from avrare.estimation.monte_carlo.config import McConfig
from avrare.plugin.registry import default_registry
from avrare.scenario.schema import Block


def arms(text, settings=(), own=None):
    return parse_arms(text, settings, own, default_registry())


def own_block(**options):
    component = default_registry().get("estimator", "mc")
    return Block("mc", component, McConfig(**options))


def test_variants_keep_their_options_and_their_spelling():
    found = arms("mc, ams ,ams:particles=100:discard=10")
    assert [arm.label for arm in found] == ["mc", "ams", "ams:particles=100:discard=10"]
    assert [arm.name for arm in found] == ["mc", "ams", "ams"]
    assert dict(found[2].options) == {"particles": 100, "discard": 10}
    assert (found[2].config.particles, found[1].config.particles) == (100, 250)
    assert found[2].label_parts == ["ams", "particles=100", "discard=10"]
    assert found[2].distribution == "avrare-estimators"


def test_values_may_hold_commas_and_colons_inside_braces():
    found = arms("is:proposal={name: gaussian, mean: 0.4, std: 1.1}:runs=2,mc")
    assert found[0].options == {"proposal": {"name": "gaussian", "mean": 0.4, "std": 1.1}, "runs": 2}
    assert [arm.name for arm in found] == ["is", "mc"]


def test_settings_are_for_every_variant_and_the_variant_wins():
    found = arms("ams,ams:discard=7,mc", ["ams.discard=5", "ams.particles=60"])
    assert [(arm.config.particles, arm.config.discard) for arm in found[:2]] == [(60, 5), (60, 7)]
    assert found[2].options == {}


def test_the_scenarios_own_options_apply_to_its_estimator_only():
    found = arms("mc,mc:rollouts=7,ams", own=own_block(rollouts=33))
    assert [dict(arm.options) for arm in found] == [{"rollouts": 33}, {"rollouts": 7}, {}]


def test_settings_of_the_scenario_are_separate_from_those_of_estimators():
    assert split_settings(["scenario.steps=6", "ams.particles=9"]) == (["steps=6"], ["ams.particles=9"])


@pytest.mark.parametrize(
    ("text", "settings", "message"),
    [
        ("mc,,ams", [], "name is missing"),
        ("mc,mc", [], "twice"),
        ("mc:rolouts=3", [], "unknown option 'rolouts'"),
        ("mc:rollouts=many", [], "rollouts"),
        ("mc:seed=3", [], "a setting of the whole comparison"),
        ("is:proposal=bananas", [], "proposal"),
        ("mc", ["ams.particles=9"], "NAME.OPTION=VALUE"),
    ],
)
def test_wrong_arguments_are_a_clear_error(text, settings, message):
    with pytest.raises(AvrareError) as caught:
        arms(text, settings)
    assert message in "\n".join(caught.value.lines())


def test_an_unknown_estimator_is_a_missing_plugin():
    with pytest.raises(PluginError) as caught:
        arms("mc,amss")
    assert "'ams'" in caught.value.hint
    assert not isinstance(caught.value, UsageError)
