"""Both sets of definitions against plain scalar code that follows the sources sentence by sentence."""

from dataclasses import dataclass

import numpy as np
import pytest

N, T = 60, 9
LANES = (-1.75, 1.75, 5.25)
INF = float("inf")
SIZES = np.linspace(3.0, 7.0, 8), np.linspace(1.6, 2.4, 8)


@dataclass
class Car:
    x: float
    y: float
    heading: float
    speed: float
    acceleration: float
    length: float
    width: float

    def point(self, along, across):
        """Return a point of the car, given by shares of its length and width from the centre."""
        turn = np.exp(1j * self.heading)
        point = self.x + 1j * self.y + turn * (along * self.length + 1j * across * self.width)
        return point.real, point.imag


def cars(samples, t, n, vehicles):
    """Return the ego and the others of one sample and row."""
    fields = ("x", "y", "heading", "speed", "acceleration")
    ego = Car(*(samples[t][f"ego_{name}"][n] for name in fields), 4.0, 2.0)
    rows = [[samples[t][f"others_{name}"][n, v] for name in fields] for v in range(vehicles)]
    return ego, [Car(*row, SIZES[0][v], SIZES[1][v]) for v, row in enumerate(rows)]


def drive(lab, name, vehicles, seed, **options):
    """Return signals of random crowds, and the monitor's robustness and violated, (N, T) each."""
    rng = np.random.default_rng(seed)
    sizes = SIZES[0][:vehicles], SIZES[1][:vehicles]
    rule = lab.rule(name, vehicles, sizes=sizes, cut_in_time=0.3, **options)
    samples = [lab.random(rng, N, vehicles) for _ in range(T)]
    state, robustness, violated = rule.start(N), [], []
    for signals in samples:
        state, verdict = rule.update(state, signals)
        robustness.append(verdict.robustness)
        violated.append(verdict.violated)
    return samples, np.stack(robustness, 1), np.stack(violated, 1)


# Innes and Ramamoorthy: robustness, to the last digit


def p_in_lane(c, lane):
    points = [(0.0, 0.0), (0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5)]
    return 0.875 - min(abs(c.point(*point)[1] - lane) for point in points)


def p_same_lane(a, b):
    return max(min(p_in_lane(a, lane), p_in_lane(b, lane)) for lane in LANES)


def p_in_front(a, b):
    return a.point(-0.5, 0.0)[0] - b.point(0.5, 0.0)[0]


def p_single_lane(c):
    best, second = sorted((p_in_lane(c, lane) for lane in LANES), reverse=True)[:2]
    return min(best, -second)


def p_cut_in(e, o):
    approaching = max(min(e.y - o.y, o.heading), min(o.y - e.y, -o.heading))
    return min(-p_single_lane(o), approaching, p_same_lane(e, o))


def p_safe(e, o):
    return p_in_front(o, e) - o.length


def p_left_of(o, e):
    rear_o, front_o = o.point(-0.5, 0.0)[0], o.point(0.5, 0.0)[0]
    rear_e, front_e = e.point(-0.5, 0.0)[0], e.point(0.5, 0.0)[0]
    beside = max(
        min(rear_o - rear_e, front_e - rear_o),
        min(front_o - front_e, rear_e - rear_o),
        min(front_o - rear_e, front_e - front_o),
    )
    return min(o.point(0.0, -0.5)[1] - e.point(0.0, 0.5)[1], beside)


def published_rg1(history, t):
    def cut_in_began(k, v):
        before = -p_cut_in(history[k - 1][0], history[k - 1][1][v]) if k else INF
        return min(p_cut_in(history[k][0], history[k][1][v]), before)

    def body(v, e, o):
        began = max(cut_in_began(k, v) for k in range(max(0, t - 3), t + 1))
        return max(-min(p_same_lane(e, o), p_in_front(o, e), -began), p_safe(e, o))

    e, others = history[t]
    return min(body(v, e, o) for v, o in enumerate(others))


def published_rg2(history, t):
    e, others = history[t]
    free = -max(min(p_in_front(o, e), p_same_lane(o, e)) for o in others)
    reason = min(free, -4.75 - e.acceleration)
    for o in others:
        relative = -4.75 - (e.acceleration - min(0.0, o.acceleration))
        reason = max(reason, min(p_safe(e, o), p_in_front(o, e), p_same_lane(o, e), relative))
    return -min(-e.acceleration, reason)


def published_rg4(history, t):
    e, others = history[t]
    slow = max(min(21.6 - o.speed, p_same_lane(e, o), p_in_front(o, e)) for o in others)
    return max(slow, e.speed - 21.6)


def published_ri2(history, t):
    def body(e, o):
        faster, blocked = e.speed - o.speed, -INF
        return max(
            -min(p_left_of(o, e), faster),
            min(blocked, min(faster, 5.55 - faster)),
            min(p_in_lane(e, -1.75), max(p_in_lane(o, 1.75), p_in_lane(o, 5.25)), -blocked),
        )

    e, others = history[t]
    return min(body(e, o) for o in others)


PUBLISHED = {"R_G1": published_rg1, "R_G2": published_rg2, "R_G4": published_rg4, "R_I2": published_ri2}


@pytest.mark.slow
@pytest.mark.parametrize("vehicles", [1, 3])
@pytest.mark.parametrize("name", PUBLISHED)
def test_published_definitions_equal_a_plain_implementation(lab, name, vehicles):
    options = {"definitions": "published", "abrupt_braking": -4.75, "speed_limit": 36.6}
    samples, robustness, violated = drive(lab, name, vehicles, 10 + vehicles, **options)
    expected = np.empty((N, T))
    for n in range(N):
        history = [cars(samples, t, n, vehicles) for t in range(T)]
        expected[n] = np.minimum.accumulate([PUBLISHED[name](history, t) for t in range(T)])
    np.testing.assert_allclose(robustness, expected, atol=1e-12)
    assert np.array_equal(violated, expected < 0.0)
    assert violated.any()
    assert not violated.all()


def test_the_published_braking_rule_is_475_for_a_coasting_ego(lab):
    options = {"definitions": "published", "abrupt_braking": -4.75}
    assert lab.judge(lab.rule("R_G2", 0, **options)) == (False, 4.75)


def test_the_published_braking_rule_considers_all_vehicles_ahead(lab):
    """Put two ahead: the nearest is too near, which excuses; the published code also asks the second one."""
    pair = [{"x": 7.0}, {"x": 60.0}]
    assert not lab.judge(lab.rule("R_G2", 2), *pair, acceleration=-8.0)[0]
    assert lab.judge(lab.rule("R_G2", 2, definitions="published"), *pair, acceleration=-8.0)[0]


# Maierhofer et al.: truth


def corners(c):
    return [c.point(a, b) for a in (-0.5, 0.5) for b in (-0.5, 0.5)]


def lanes(c):
    low, high = min(y for _, y in corners(c)), max(y for _, y in corners(c))
    return {lane for lane in LANES if high > lane - 1.75 and low < lane + 1.75}


def front(c):
    return max(x for x, _ in corners(c))


def rear(c):
    return min(x for x, _ in corners(c))


def ahead(o, e):
    return bool(lanes(o) & lanes(e)) and rear(o) > front(e)


def safe(e, o):
    needed = e.speed**2 / 20.0 - o.speed**2 / 21.0 + 0.4 * e.speed
    return rear(o) - front(e) >= max(needed, 0.0)


def cutting_in(e, o):
    approaching = (o.y > e.y and o.heading < 0.0) or (o.y < e.y and o.heading > 0.0)
    return len(lanes(o)) != 1 and bool(lanes(o) & lanes(e)) and approaching


def breaks_rg1(history, t):
    def began(k, v):
        now, before = (cutting_in(history[j][0], history[j][1][v]) for j in (k, max(k - 1, 0)))
        return now and (k == 0 or not before)

    e, others = history[t]
    return any(
        ahead(o, e) and not any(began(k, v) for k in range(max(0, t - 3), t + 1)) and not safe(e, o)
        for v, o in enumerate(others)
    )


def breaks_rg2(history, t):
    e, others = history[t]
    preceding = min((o for o in others if ahead(o, e)), key=rear, default=None)
    if e.acceleration >= -2.0:
        return False
    if preceding is None:
        return True
    relative = e.acceleration - min(0.0, preceding.acceleration)
    return safe(e, preceding) and relative < -2.0


def breaks_rg4(history, t):
    e, others = history[t]
    return not any(ahead(o, e) and o.speed < 21.11 for o in others) and e.speed < 21.11


def breaks_ri2(history, t):
    e, others = history[t]
    for o in others:
        beside = rear(o) < front(e) and rear(e) < front(o)
        left = min(y for _, y in corners(o)) > max(y for _, y in corners(e))
        queue = sum(ahead(p, o) and p.speed < 16.67 for p in others if p is not o) >= 3
        passes_queue = queue and e.speed - o.speed < 5.55
        from_ramp = -1.75 in lanes(e) and bool(lanes(o) & {1.75, 5.25}) and not queue
        if left and beside and e.speed > o.speed and not passes_queue and not from_ramp:
            return True
    return False


RECOMMENDED = {"R_G1": breaks_rg1, "R_G2": breaks_rg2, "R_G4": breaks_rg4, "R_I2": breaks_ri2}


@pytest.mark.slow
@pytest.mark.parametrize("vehicles", [1, 8])
@pytest.mark.parametrize("name", RECOMMENDED)
def test_recommended_definitions_equal_a_plain_implementation(lab, name, vehicles):
    samples, robustness, violated = drive(lab, name, vehicles, 20 + vehicles)
    expected = np.zeros((N, T), dtype=bool)
    for n in range(N):
        history = [cars(samples, t, n, vehicles) for t in range(T)]
        expected[n] = np.logical_or.accumulate([RECOMMENDED[name](history, t) for t in range(T)])
    assert np.array_equal(violated, expected)
    assert np.array_equal(robustness < 0.0, expected)
    assert expected.any()
    assert not expected.all()
