import numpy as np
import pytest

from avrare.driving import Road, Scene
from avrare_reference_drivers.avoidable_collision import avoidable_ttc, build
from avrare_reference_drivers.config import AvoidableCollisionConfig

KMH = np.arange(10, 61, 10) / 3.6


def monitor(**options):
    road = Road(lane_centres=(0.0, 3.5), lane_width=3.5)
    size = np.array([4.0]), np.array([2.0])
    scene = Scene(0.1, road, 4.0, 2.0, ("car",), *size, np.array([True]))
    return build(AvoidableCollisionConfig(**options), scene)


def sample(gap, y, distance, speed=10.0):
    others = {"x": gap + 4.0, "y": y, "speed": speed, "heading": 0.0}
    values = {f"others_{name}": [[value]] for name, value in others.items()} | {"distance": [[distance]]}
    values |= {"ego_x": [0.0], "ego_y": [0.0], "ego_speed": [20.0]}
    return {name: np.array(value) for name, value in values.items()}


def judge(samples, **options):
    specification = monitor(**options)
    state, verdicts = specification.start(1), []
    for signals in samples:
        state, verdict = specification.update(state, signals)
        verdicts.append((bool(verdict.violated[0]), float(verdict.robustness[0])))
    return verdicts


def test_the_tables_of_the_regulation():
    np.testing.assert_allclose(avoidable_ttc(KMH), [0.48, 0.71, 0.94, 1.18, 1.41, 1.64], atol=0.006)
    standing = [0.74, 1.32, 1.90, 2.47, 3.05, 3.63]
    np.testing.assert_allclose(avoidable_ttc(KMH, standing_passengers=True), standing, atol=0.006)


def test_a_collision_counts_only_after_an_early_cut_in():
    aside, touching = sample(30.0, 3.5, 1.5), sample(-1.0, 0.0, -1.0)
    early = judge([aside, sample(12.0, 2.44, 10.0), touching])  # 1.2 s, 1.083 s asked
    late = judge([aside, sample(9.0, 2.44, 8.0), touching])
    assert [violated for violated, _ in early] == [False, False, True]
    assert [violated for violated, _ in late] == [False, False, False]
    assert early[-1][1] == pytest.approx(-(1.2 - 10.0 / 12.0 - 0.25))
    assert late[-1][1] == pytest.approx(10.0 / 12.0 + 0.25 - 0.9)


def test_the_time_counts_from_the_intrusion():
    samples = [sample(12.0, 2.46, 2.0), sample(9.0, 2.44, 2.0), sample(-1.0, 0.0, -1.0)]
    assert not judge(samples)[-1][0]
    assert judge(samples, intrusion=0.28)[-1][0]


def test_a_vehicle_that_is_not_approached_must_be_avoided():
    assert judge([sample(2.0, 0.0, 2.0, speed=25.0), sample(-1.0, 0.0, -1.0)])[-1][0]


def test_a_vehicle_that_comes_from_behind_is_not_the_egos_duty():
    assert not judge([sample(-10.0, 0.0, 2.0, speed=30.0), sample(-1.0, 0.0, -1.0)])[-1][0]


def test_without_vehicles_nothing_is_violated():
    road = Road(lane_centres=(0.0, 3.5), lane_width=3.5)
    none = np.zeros(0)
    specification = build(AvoidableCollisionConfig(), Scene(0.1, road, 4.0, 2.0, (), none, none, none > 0))
    one = sample(1.0, 0.0, 1.0)
    signals = {name: value[..., :0] if value.ndim == 2 else value for name, value in one.items()}
    assert not specification.update(specification.start(1), signals)[1].violated.any()
