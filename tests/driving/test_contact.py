"""First contact between two samples, against closed forms and a fine sweep."""

import dataclasses

import numpy as np
import pytest

from avrare.driving import Road, Scene, Vehicles
from avrare.driving.geometry import (
    ego_rectangle,
    find_contacts,
    interpolate,
    other_rectangles,
    signed_distance,
)
from avrare.driving.reference_line import CurvedLine, Piece


def scene(vehicles=1, line=None, dt=0.1):
    size = np.ones(vehicles)
    road = Road((0.0,), 3.5, line=line)
    return Scene(dt, road, 4.0, 2.0, tuple("abcdefgh"[:vehicles]), 4.0 * size, 2.0 * size, size > 0)


def car(x, y=0.0, heading=0.0, speed=0.0):
    parts = np.broadcast_arrays(*(np.asarray(value, float) for value in (x, y, heading, speed, 0.0)))
    return Vehicles(*(np.array(part) for part in parts))


def test_two_cars_head_on_are_caught_between_samples():
    # 40 m/s each, 8 m nearer in a step, and 3.5 m long: they are apart at both samples
    place = dataclasses.replace(scene(), ego_length=3.5, lengths=np.full(1, 3.5))
    before, after = (car([0.0]), car([[3.9]], heading=np.pi)), (car([4.0]), car([[-0.1]], heading=np.pi))
    for ego, others in (before, after):
        assert signed_distance(ego_rectangle(ego, place), other_rectangles(others, place)) > 0.0
    share = find_contacts(place, before, after)
    np.testing.assert_allclose(share, 0.4 / 8.0, atol=0.02 / 8.0)


@pytest.mark.parametrize(("aside", "touched"), [(1.9, True), (2.1, False)])
def test_a_car_that_passes_aside_is_not_touched(aside, touched):
    before, after = (car([0.0]), car([[5.0]], aside)), (car([10.0]), car([[5.0]], aside))
    assert np.isfinite(find_contacts(scene(), before, after)).all() == touched


def test_a_turn_between_two_samples_is_swept():
    # the ego turns its corner into the other and back: the shorter way round is through its heading
    before, after = ((car([0.0], heading=turn), car([[0.0]], 2.5)) for turn in (0.4, -0.4))
    share = find_contacts(scene(), before, after)
    assert share[0, 0] == 0.0  # 2 |sin 0.4| + cos 0.4 > 1.5: it touches at once
    clear = find_contacts(scene(), (before[0], car([[0.0]], 3.5)), (after[0], car([[0.0]], 3.5)))
    assert np.isinf(clear).all()


def test_a_vehicle_that_appears_is_not_swept_through():
    before, after = (car([0.0]), car([[-1e6]])), (car([1.0]), car([[30.0]]))
    assert np.isinf(find_contacts(scene(), before, after)).all()


@pytest.mark.parametrize("line", [None, CurvedLine((Piece(300.0, 0.02, 0.02),))], ids=["straight", "bend"])
def test_it_agrees_with_a_fine_sweep(line):
    rng, n, vehicles = np.random.default_rng(0), 400, 3
    place = scene(vehicles, line, dt=1.0)

    def draw(shape, x, y, h):
        deviations = (rng.normal(0.0, sd, shape) for sd in (6.0, 2.0, 0.3))
        return car(*(mean + off for mean, off in zip((x, y, h), deviations, strict=True)), 20.0)

    before = draw(n, 50.0, 0.0, 0.0), draw((n, vehicles), 55.0, 0.0, 0.0)
    after = draw(n, 54.0, 0.0, 0.0), draw((n, vehicles), 53.0, 0.0, 0.0)
    share = find_contacts(place, before, after)
    fine = []
    for at in np.linspace(0.0, 1.0, 801):
        ego, others = (interpolate(*pair, at) for pair in zip(before, after, strict=True))
        fine.append(signed_distance(ego_rectangle(ego, place), other_rectangles(others, place)))
    least = np.min(fine, axis=0)
    assert (least[np.isfinite(share)] <= 0.02).all()
    assert (least[np.isinf(share)] > -0.02).all()
    assert 0.2 < np.isfinite(share).mean() < 0.9
    first = np.argmax(np.array(fine) <= 0.0, axis=0) / 800.0
    both = np.isfinite(share) & (least <= 0.0)
    assert np.quantile(np.abs(share - first)[both], 0.99) < 0.01
