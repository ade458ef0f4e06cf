"""Kernels of drivers that react: IDM along the road, MOBIL and gap acceptance across it.

Along the road the intelligent driver model (Treiber, Hennecke and Helbing, Physical Review E 62, 2000):

    a (1 - (v / v0)^4 - (s* / s)^2),    s* = s0 + max(0, v T + v (v - u) / (2 sqrt(a b)))

with the gap s and the speed u of the vehicle ahead; of several ahead in its lane the one that asks for the
hardest braking counts, as who leaves the lane may have hidden one that stands. A cool driver brakes calmly
for a gap that closes slowly, as after a cut-in (Kesting, Treiber and Helbing, Philosophical Transactions A
368, 2010; the vehicle ahead is taken to keep its speed). A lane is changed by MOBIL (Kesting, Treiber and
Helbing, Transportation Research Record 1999, 2007): where nobody behind must brake harder than is safe, and
the gain of the driver and, weighed by politeness, of the two followers is above a threshold. A merge asks
for the safe gaps alone, at every step. Who changes lanes signals: it is seen in both from the first step on.
What the model demands may take effect late, after a reaction time: all that it sees is of that time ago
(Treiber, Kesting and Helbing, Physica A 360, 2006). All functions stand in this file, since numba's cache
looks at no other.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from avrare.protocols import Floats
from avrare_mpc.riccati.jit import entry, inline

Integers = NDArray[np.int64]

PARAMETERS = (
    "desired_speed",
    "time_gap",
    "standstill_gap",
    "acceleration",
    "deceleration",
    "braking_max",
    "politeness",
    "gain",
    "safe_braking",
    "lane_change_time",
    "reaction_time",
    "coolness",
)
"""Parameters of a driver, in the order of the last axis of the kernel's table."""
_MARGIN = 0.25
"""Distance that a vehicle may reach into a lane before it counts as in it [m]."""
_CRAWL = 0.5
"""Speed below which a lane change rests [m/s]."""
_TOUCH = 0.1
"""Least gap that enters the model [m]."""


@inline
def idm(v: float, u: float, gap: float, p: Floats) -> float:
    """Return the acceleration at speed ``v``, ``gap`` behind a vehicle at speed ``u`` (inf: behind none)."""
    wanted = 0.0 if v == 0.0 else -math.inf  # who wants to stand
    if p[0] > 0.0:
        ratio = v / p[0]
        wanted = 1.0 - ratio * ratio * ratio * ratio
    if gap < math.inf:
        s = p[2] + max(0.0, v * p[1] + 0.5 * v * (v - u) / math.sqrt(p[3] * p[4]))
        near = s / max(gap, _TOUCH)
        wanted -= near * near
    acceleration: float = max(p[3] * wanted, -p[5])
    return acceleration


@inline
def _sort(
    x: Floats,
    y: Floats,
    widths: Floats,
    centres: Floats,
    half: float,
    order: Integers,
    rank: Integers,
    lanes: Integers,
) -> None:
    # Vehicles by x, the place of each among them, and a bit for each lane that it is in.
    for i in range(len(x)):
        k = i
        while k > 0 and x[order[k - 1]] > x[i]:
            order[k] = order[k - 1]
            k -= 1
        order[k] = i
        lanes[i] = 0
        for c in range(len(centres)):
            if abs(y[i] - centres[c]) < half + 0.5 * widths[i]:
                lanes[i] |= 1 << c
    for k in range(len(x)):
        rank[order[k]] = k


@inline
def _ahead(
    x: Floats, lengths: Floats, order: Integers, rank: Integers, lanes: Integers, i: int, lane: int
) -> tuple[int, float]:
    # Nearest vehicle ahead in a lane, -1 for none, and the gap to it.
    for k in range(rank[i] + 1, len(order)):
        j = order[k]
        if lanes[j] >> lane & 1:
            return j, x[j] - x[i] - 0.5 * (lengths[i] + lengths[j])
    return -1, math.inf


@inline
def _behind(
    x: Floats, lengths: Floats, order: Integers, rank: Integers, lanes: Integers, i: int, lane: int
) -> tuple[int, float]:
    for k in range(rank[i] - 1, -1, -1):
        j = order[k]
        if lanes[j] >> lane & 1:
            return j, x[i] - x[j] - 0.5 * (lengths[i] + lengths[j])
    return -1, math.inf


@inline
def _follow(v: Floats, i: int, ahead: int, gap: float, p: Floats) -> float:
    u = v[ahead] if ahead >= 0 else 0.0
    a = idm(v[i], u, gap, p)
    needed = -0.5 * max(v[i] - u, 0.0) ** 2 / max(gap, _TOUCH)
    if p[11] > 0.0 and gap < math.inf and a < needed:
        cool = needed - p[4] * math.tanh((needed - a) / p[4])
        a = max((1.0 - p[11]) * a + p[11] * cool, -p[5])
    return a


@inline
def _follow_all(
    x: Floats, v: Floats, lengths: Floats, order: Integers, rank: Integers, lanes: Integers, i: int,
    lane: int, p: Floats,
) -> float:  # fmt: skip
    # What the vehicles ahead in a lane allow. One beyond a slower one never asks for more.
    a, slowest = _follow(v, i, -1, math.inf, p), math.inf
    for k in range(rank[i] + 1, len(order)):
        j = order[k]
        if lanes[j] >> lane & 1 and v[j] < slowest:
            a = min(a, _follow(v, i, j, x[j] - x[i] - 0.5 * (lengths[i] + lengths[j]), p))
            slowest = v[j]
    return a


@inline
def _incentive(
    x: Floats, v: Floats, lengths: Floats, order: Integers, rank: Integers, lanes: Integers, i: int, now: int,
    to: int, p: Floats, drivers: Integers, table: Floats, end: float, new_end: float,
) -> tuple[bool, float]:  # fmt: skip
    # Whether a change is safe, and what it gains by MOBIL. Followers that are no drivers are taken for
    # drivers like this one; who drives the other way has passed. ``end`` and ``new_end`` are the ways to the
    # ends of both lanes.
    new_ahead, new_gap = _ahead(x, lengths, order, rank, lanes, i, to)
    new, new_behind = _behind(x, lengths, order, rank, lanes, i, to)
    after = _follow_all(x, v, lengths, order, rank, lanes, i, to, p)
    if new_end < math.inf:
        after = min(after, idm(v[i], 0.0, new_end, p))
    if after < -p[8] or new_gap <= 0.0 or new_behind <= 0.0:
        return False, 0.0
    ahead, gap = _ahead(x, lengths, order, rank, lanes, i, now)
    old, behind = _behind(x, lengths, order, rank, lanes, i, now)
    imposed, gained = 0.0, 0.0
    if new >= 0 and v[new] >= 0.0:
        q = table[drivers[new]] if drivers[new] >= 0 else p
        # Until its reaction time is over it goes on as it does now.
        undisturbed = _follow(v, new, new_ahead, new_gap + new_behind + lengths[i], q)
        later = max(v[new] + undisturbed * q[10], 0.0)
        closed = q[10] * (0.5 * (v[new] + later) - v[i])
        imposed = idm(later, v[i], new_behind - max(closed, 0.0), q)
        if imposed < -p[8]:
            return False, 0.0
        imposed -= undisturbed
    if old >= 0 and v[old] >= 0.0 and p[6] > 0.0:
        q = table[drivers[old]] if drivers[old] >= 0 else p
        gained = _follow(v, old, ahead, gap + behind + lengths[i], q) - idm(v[old], v[i], behind, q)
    current = _follow_all(x, v, lengths, order, rank, lanes, i, now, p)
    if end < math.inf:
        current = min(current, idm(v[i], 0.0, end, p))
    return True, after - current + p[6] * (imposed + gained)


@inline
def _choose_lane(
    x: Floats, v: Floats, lengths: Floats, order: Integers, rank: Integers, lanes: Integers,
    drivers: Integers, parameters: Floats, p: Floats, i: int, here: int, first: int, last: int, wanted: int,
    looking: bool, end: float, spans: Floats,
) -> int:  # fmt: skip
    # Lane beside to change to, -1 for none: the one wanted as soon as it is safe, or the one that pays most.
    best, chosen = p[7], -1
    merging = wanted >= 0 and wanted != here
    for side in (-1, 1):
        to = here + side
        chooses = looking and first <= to <= last
        if chooses or (merging and (wanted - here) * side > 0):
            half = 0.5 * lengths[i]
            new_end = spans[1, to] - x[i] - half
            if x[i] - half < spans[0, to] or new_end < 0.0:
                continue  # there is no such lane here
            safe, gain = _incentive(
                x, v, lengths, order, rank, lanes, i, here, to, p, drivers, parameters, end, new_end
            )
            if safe and (merging or gain > best):
                best, chosen = gain, to
    return chosen


@inline
def _curve(across: float, share: float, time: float) -> tuple[float, float]:
    # Way to the side so far, and its rate, on a polynomial of fifth degree.
    way = across * share**3 * (10.0 - 15.0 * share + 6.0 * share * share)
    return way, across * 30.0 * share**2 * (1.0 - share) ** 2 / time


@inline
def _way_to_end(spans: Floats, end: float, start: int, lane: int, x: float, length: float) -> float:
    # From a front to the end of a lane; ``end`` is that of the lane of the start.
    end = min(spans[1, lane], end if lane == start else math.inf)
    return end - x - 0.5 * length


@inline
def _delay_demand(past: Floats, step: int, late: float, now: float) -> float:
    # What was demanded ``late`` steps ago, by a ring of past demands; before the start what was at the start.
    size = len(past)
    past[step % size] = now
    late = min(late, float(min(size - 2, step)))
    whole = int(late)
    earlier, later = past[(step - whole) % size], past[(step - min(whole + 1, step)) % size]
    demand: float = earlier + (late - whole) * (later - earlier)
    return demand


@inline
def _limit_by_braking(brake: Floats, row: int, step: int, a: float) -> float:
    for k in range(len(brake)):
        if brake[k, 0] == row and brake[k, 1] <= step <= brake[k, 2]:
            a = min(a, brake[k, 3])
    return a


# Arguments of ``advance``. It computes the model's acceleration itself: as a kernel of its own that would
# take half as long again.
#
#     x: (N, V) positions along the road [m].
#     y: (N, V) positions across it [m].
#     v: (N, V) speeds [m/s].
#     lengths: (V,) lengths [m].
#     widths: (V,) widths [m].
#     drivers: (V,) index of each vehicle among the drivers, -1 for others.
#     places: (R,) index of each driver among the vehicles.
#     table: (1 or N, R, 12) ``PARAMETERS``.
#     limits: (R, 2) first and last lane that a driver may choose.
#     ends: (R,) x at which the lane of its start ends [m], inf where it does not.
#     forced: (R, 3) lane of a merge (-1: none), step from which it is wanted, lane of the start.
#     brake: (B, 4) driver, first and last step, acceleration [m/s^2] of scripted braking.
#     centres: (L,) lane centres [m].
#     spans: (2, L) x where each lane begins and ends [m], infinite where it does not.
#     width: Lane width [m].
#     dt: Step [s].
#     step: (N,) steps so far.
#     mood: (N, R) added to the model's acceleration [m/s^2].
#     late: (N, R) steps after which what the model demands takes effect.
#     pause_after: Time after a change before the next [s].
#     look: Time between two comparisons of the lanes [s].
#     lane: (N, R) lane of each driver; changed in place, as the next four.
#     base: (N, R) y from which a change began, or that is kept [m].
#     clock: (N, R) time since a change began, -1 where none is under way [s].
#     pause: (N, R) time until a change may begin [s].
#     past: (N, R, K) what the model demanded at the last K steps [m/s^2]; K = 0 where nobody is late.
#     out: (5, N, R) x, y, heading, speed and acceleration after the step.
@entry
def advance(
    x: Floats, y: Floats, v: Floats, lengths: Floats, widths: Floats, drivers: Integers, places: Integers,
    table: Floats, limits: Integers, ends: Floats, forced: Integers, brake: Floats, centres: Floats,
    spans: Floats, width: float, dt: float, step: Integers, mood: Floats, late: Floats, pause_after: float,
    look: float, lane: Integers, base: Floats, clock: Floats, pause: Floats, past: Floats, out: Floats,
) -> None:  # fmt: skip
    """Advance R drivers among V vehicles (the ego is the last) by one step, in N particles."""
    half = 0.5 * width - _MARGIN
    order, rank, lanes = np.empty_like(drivers), np.empty_like(drivers), np.empty_like(drivers)
    for n in range(len(x)):
        _sort(x[n], y[n], widths, centres, half, order, rank, lanes)
        for r in range(len(places)):
            if clock[n, r] >= 0.0:  # it signals
                lanes[places[r]] |= 1 << lane[n, r]
        parameters = table[n] if len(table) > 1 else table[0]
        at, speeds = x[n], v[n]
        for r in range(len(places)):
            i, p, here = places[r], parameters[r], lane[n, r]
            end = _way_to_end(spans, ends[r], forced[r, 2], here, at[i], lengths[i])
            if clock[n, r] < 0.0:
                pause[n, r] -= dt
                wanted = forced[r, 0] if step[n] >= forced[r, 1] else -1
                looking = wanted < 0 and pause[n, r] <= 0.0
                if looking:
                    pause[n, r] = look
                chosen = -1
                if looking or (wanted >= 0 and wanted != here):
                    chosen = _choose_lane(
                        at, speeds, lengths, order, rank, lanes, drivers, parameters, p, i, here,
                        limits[r, 0], limits[r, 1], wanted, looking, end, spans,
                    )  # fmt: skip
                if chosen >= 0:
                    lane[n, r], clock[n, r], base[n, r] = chosen, 0.0, y[n, i]
                    end = _way_to_end(spans, ends[r], forced[r, 2], chosen, at[i], lengths[i])
            changing = clock[n, r] >= 0.0
            a = _follow_all(at, speeds, lengths, order, rank, lanes, i, lane[n, r], p)
            if changing:  # still between the lanes: the old one counts as well
                for c in range(len(centres)):
                    if lanes[i] >> c & 1:
                        a = min(a, _follow_all(at, speeds, lengths, order, rank, lanes, i, c, p))
            if end < math.inf:
                a = min(a, idm(speeds[i], 0.0, end, p))
            if past.shape[2] > 0:
                a = _delay_demand(past[n, r], step[n], late[n, r], a)
            a += mood[n, r]
            a = min(max(_limit_by_braking(brake, r, step[n], a), -p[5]), p[3])
            speed = max(speeds[i] + a * dt, 0.0)
            out[0, n, r] = at[i] + 0.5 * dt * (speeds[i] + speed)
            out[1, n, r], out[2, n, r] = y[n, i], 0.0
            out[3, n, r], out[4, n, r] = speed, (speed - speeds[i]) / dt
            if changing:
                if speed > _CRAWL:
                    clock[n, r] += dt
                share = min(clock[n, r] / p[9], 1.0)
                way, rate = _curve(centres[lane[n, r]] - base[n, r], share, p[9])
                out[1, n, r] = base[n, r] + way
                out[2, n, r] = math.atan2(rate, speed) if speed > _CRAWL else 0.0
                if share >= 1.0:
                    clock[n, r], pause[n, r], base[n, r] = -1.0, pause_after, out[1, n, r]
