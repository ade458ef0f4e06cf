"""The example follows the advice to authors; tests/testing/conformance/test_example.py installs its wheel."""

import numpy as np
import pytest

import avrare
from avrare.base.errors import UsageError
from avrare.testing.conformance import Subject, checks_of
from avrare_example.config import SpillageConfig, TankConfig
from avrare_example.spillage import build as build_spillage
from avrare_example.tank import build as build_tank


@pytest.mark.parametrize(("kind", "name"), [("simulator", "tank"), ("specification", "spillage")])
def test_conforms(kind, name):
    outcomes = [check.run(Subject.find_installed(kind, name)) for check in checks_of(kind)]
    assert len(outcomes) == 13
    assert [(one.check, one.reason) for one in outcomes if one.status != "passed"] == []


def test_water_is_neither_made_nor_lost():
    tank = build_tank(TankConfig(rim=1.05))
    noise = np.random.default_rng(3).standard_normal((40, 8, 1))
    world = tank.reset(noise[0])
    for step in range(1, 40):
        later = tank.step(world, None, noise[step])
        outflow = 0.002 * np.sqrt(2.0 * 9.81 * world.level)
        gained = 10.0 * (tank.signals(later)["inflow"] - outflow)
        np.testing.assert_allclose(2.0 * (later.level - world.level) + later.spilled, gained, atol=1e-12)
        world = later
    assert (world.level <= 1.05).all()


def test_spillage_is_the_sum_over_time():
    spillage = build_spillage(SpillageConfig(limit=0.5))
    state = spillage.start(2)
    for spilled in ([0.2, 0.0], [0.3, 0.4], [0.1, 0.0]):
        state, verdict = spillage.update(state, {"spilled": np.array(spilled)})
    assert verdict.violated.tolist() == [True, False]
    np.testing.assert_allclose(verdict.robustness, [-0.1, 0.1])


def test_mistakes_are_reported():
    with pytest.raises(UsageError, match="above the rim"):
        build_tank(TankConfig(start=3.0))
    spillage = build_spillage(SpillageConfig())
    with pytest.raises(UsageError, match="needs the signal 'spilled'"):
        spillage.update(spillage.start(1), {"level": np.zeros(1)})


@pytest.mark.slow
def test_splitting_agrees_with_monte_carlo(tmp_path):
    path = tmp_path / "tank.yaml"
    path.write_text(
        "name: tank\nsteps: 60\nchunk: 1000\nsimulator: {plugin: tank}\n"
        "specifications:\n  dry: {plugin: spillage, limit: 0.2}\n  low: {stl: always (level < 1.9)}\n"
    )
    problem = avrare.load(path).problem("low")
    brute = avrare.estimate(problem, "mc", rollouts=4000, seed=1)
    split = avrare.estimate(problem, "ams", particles=100, discard=10, runs=10, seed=2)
    assert 0.001 < brute.probability < 0.2
    assert brute.interval_at(0.999)[0] < split.probability < brute.interval_at(0.999)[1]
    dry = avrare.estimate(avrare.load(path).problem("dry"), "mc", rollouts=4000, seed=1)
    assert 0.0 < dry.probability < brute.probability
