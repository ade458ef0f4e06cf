"""signed_distance against the Minkowski difference, a polygon whose distance from the origin it must be."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from avrare.driving import Road, Scene, Vehicles
from avrare.driving.geometry import Rectangle, ego_rectangle, other_rectangles, signed_distance

PAIRS = 600


def random_rectangles(rng, shape, spread):
    x, y = rng.uniform(-spread, spread, (2, *shape))
    length, width = rng.uniform(0.2, 6.0, (2, *shape))
    return Rectangle(x, y, rng.uniform(-4.0, 4.0, shape), length, width)


def corners(rectangle, i):
    """Return the four corners, by complex numbers."""
    box = [complex(a * rectangle.length[i], b * rectangle.width[i]) for a in (-0.5, 0.5) for b in (-0.5, 0.5)]
    points = rectangle.x[i] + 1j * rectangle.y[i] + np.exp(1j * rectangle.heading[i]) * np.array(box)
    return np.stack([points.real, points.imag], axis=1)


def brute_force(a, b, i):
    """Return the distance [m] of the origin from the edge of {p - q: p in a, q in b}, negative inside."""
    differences = (corners(a, i)[:, None] - corners(b, i)).reshape(-1, 2)
    hull = ConvexHull(differences)
    depth = hull.equations[:, 2].max()
    if depth <= 0.0:
        return depth
    p, q = differences[hull.simplices[:, 0]], differences[hull.simplices[:, 1]]
    along = q - p
    where = np.clip(-(p * along).sum(1) / (along * along).sum(1), 0.0, 1.0)
    return np.hypot(*(p + where[:, None] * along).T).min()


@pytest.mark.parametrize("spread", [1.0, 4.0, 12.0])
def test_random_pairs_against_brute_force(spread):
    rng = np.random.default_rng(int(spread))
    a, b = (random_rectangles(rng, (PAIRS,), spread) for _ in range(2))
    expected = np.array([brute_force(a, b, i) for i in range(PAIRS)])
    found = signed_distance(a, b)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert (expected < 0.0).sum() > 5
    assert (expected > 0.0).sum() > 5
    assert np.array_equal(signed_distance(b, a), found)


def test_disjoint_distance_against_points_on_the_boundaries():
    rng = np.random.default_rng(5)
    a, b = (random_rectangles(rng, (40,), 10.0) for _ in range(2))
    found = signed_distance(a, b)
    share = np.linspace(0.0, 1.0, 201)
    for i in np.flatnonzero(found > 0.0):
        boundaries = []
        for rectangle in (a, b):
            x, y = rectangle.corners()
            ring = x[i] + 1j * y[i]
            boundaries.append((ring[:, None] + share * (np.roll(ring, -1) - ring)[:, None]).ravel())
        sampled = np.abs(boundaries[0][:, None] - boundaries[1]).min()
        assert found[i] <= sampled + 1e-9
        assert sampled - found[i] < 0.03


def rectangle(x, y, heading=0.0, length=4.0, width=2.0):
    return Rectangle(*(np.array([float(value)]) for value in (x, y, heading, length, width)))


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (rectangle(7.0, 0.0), 3.0),  # bumper to bumper
        (rectangle(0.0, 5.0), 3.0),  # side by side
        (rectangle(7.0, -6.0), 5.0),  # corner to corner: 3, 4, 5
        (rectangle(3.0, 0.0), -1.0),  # overlap of 1 m along, 2 m across
        (rectangle(3.0, 1.9), -0.1),  # ... and now across is the way out
        (rectangle(0.0, 0.0, np.pi / 2), -3.0),  # a cross
        (rectangle(0.0, 0.0, length=0.5, width=0.5), -1.25),  # wholly inside
        (rectangle(2.0 + np.sqrt(0.5), 0.0, np.pi / 4, 1.0, 1.0), 0.0),  # a corner touches
        (rectangle(-5.0, 0.0, np.pi), 1.0),  # facing backwards
    ],
)
def test_known_pairs(other, expected):
    assert signed_distance(rectangle(0.0, 0.0), other)[0] == pytest.approx(expected, abs=1e-12)
    assert signed_distance(other, rectangle(0.0, 0.0))[0] == pytest.approx(expected, abs=1e-12)


def test_moving_by_the_depth_separates_the_rectangles():
    rng = np.random.default_rng(8)
    a, b = (random_rectangles(rng, (200,), 1.0) for _ in range(2))
    depth = -signed_distance(a, b)
    inside = depth > 0.0
    angles = np.linspace(0.0, 2.0 * np.pi, 721)[:, None]
    move = 0.99 * depth
    moved = Rectangle(a.x + move * np.cos(angles), a.y + move * np.sin(angles), a.heading, a.length, a.width)
    assert inside.sum() > 100
    assert (signed_distance(moved, b)[:, inside] < 0.0).all()  # no shorter way out


def scene(vehicles):
    sizes = np.linspace(3.0, 8.0, vehicles), np.linspace(1.5, 2.5, vehicles)
    names = tuple(f"car{v}" for v in range(vehicles))
    return Scene(0.1, Road((0.0,), 3.5), 4.0, 2.0, names, *sizes, np.ones(vehicles, dtype=bool))


def vehicles(rng, shape):
    places, heading = rng.uniform(-8.0, 8.0, (2, *shape)), rng.uniform(-1.0, 1.0, shape)
    return Vehicles(*places, heading, *np.zeros((2, *shape)))


def test_ego_and_others_broadcast_and_rows_are_independent():
    rng = np.random.default_rng(3)
    ego, others, place = vehicles(rng, (9,)), vehicles(rng, (9, 3)), scene(3)
    together = signed_distance(ego_rectangle(ego, place), other_rectangles(others, place))
    assert together.shape == (9, 3)
    for n in range(9):
        row = slice(n, n + 1)
        one = Vehicles(*(getattr(ego, name)[row] for name in ego.__dataclass_fields__))
        few = Vehicles(*(getattr(others, name)[row] for name in others.__dataclass_fields__))
        alone = signed_distance(ego_rectangle(one, place), other_rectangles(few, place))
        assert np.array_equal(alone[0], together[n])
        for v in range(3):
            mine = rectangle(ego.x[n], ego.y[n], ego.heading[n])
            length, width = place.lengths[v], place.widths[v]
            its = rectangle(others.x[n, v], others.y[n, v], others.heading[n, v], length, width)
            assert signed_distance(mine, its)[0] == pytest.approx(together[n, v], abs=1e-12)
