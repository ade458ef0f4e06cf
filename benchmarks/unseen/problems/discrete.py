"""Sequential problems of discrete states: faults, latches, queues, counters, codes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.special import ndtr
from scipy.stats import norm

from .case import Case, Floats, State, switch, threshold
from .exact import bell, failing, panels, survival

Moves = Iterator[tuple[object, float]]


class LatchedBrake(Case):
    """Four ghost detections in a row latch a brake, and eight steps later the car behind is there."""

    steps = 60
    start = {"run": 0, "timer": 0}
    first, again = 0.002, 0.25
    formula = "always (timer < 8)"

    def step(self, state: State, noise: Floats) -> State:
        ghost = noise[:, 0] > np.where(state["run"] > 0, threshold(self.again), threshold(self.first))
        run = np.where(ghost, state["run"] + 1, 0)
        latched = (state["timer"] > 0) | (run >= 4)
        return {"run": run, "timer": state["timer"] + latched}

    def exact(self) -> float:
        def moves(run: int) -> Moves:
            ghost = self.again if run else self.first
            yield (run + 1 if run < 3 else None), ghost
            yield 0, 1 - ghost

        return failing(0, moves, self.steps - 7)


class ShortestQueue(Case):
    """Cars join the shorter of two lanes at a toll station, and the queue reaches back into the motorway."""

    steps = 80
    noise_size = 3
    start = {"left": 0, "right": 0}
    arrivals = (0.4, 0.4, 0.2)
    served = 0.5
    formula = "always (left < 14 and right < 14)"

    def step(self, state: State, noise: Floats) -> State:
        left, right = (
            np.maximum(state[lane] - (noise[:, i] > threshold(self.served)), 0)
            for i, lane in ((1, "left"), (2, "right"))
        )
        for share in (0.6, 0.2):
            arrives, joins_left = noise[:, 0] > threshold(share), left <= right
            left, right = left + (arrives & joins_left), right + (arrives & ~joins_left)
        return {"left": left, "right": right}

    def exact(self) -> float:
        def moves(state: tuple[int, int]) -> Moves:
            for served in np.ndindex(2, 2):
                for count, share in enumerate(self.arrivals):
                    lanes = [max(queue - one, 0) for queue, one in zip(state, served, strict=True)]
                    for _ in range(count):
                        lanes[int(lanes[0] > lanes[1])] += 1
                    yield (tuple(lanes) if max(lanes) < 14 else None), share / 4

        return failing((0, 0), moves, self.steps)


class MissWindow(Case):
    """A tracker drops its track when five of the last ten detections are missing, in 100 steps."""

    steps = 100
    start = {"misses": np.zeros(10, bool)}
    miss = 0.02
    formula = "always (count < 5)"

    def step(self, state: State, noise: Floats) -> State:
        missed = noise > threshold(self.miss)
        return {"misses": np.concatenate([state["misses"][:, 1:], missed], axis=1)}

    def signals(self, state: State) -> State:
        return {"count": state["misses"].sum(axis=1)}

    def exact(self) -> float:
        def moves(window: tuple[int, ...]) -> Moves:
            for missed, share in ((1, self.miss), (0, 1 - self.miss)):
                after = (*window[1:], missed)
                yield (after if sum(after) < 5 else None), share

        return failing((0,) * 10, moves, self.steps)


class StartWhenClear(Case):
    """A car may start after six clear frames in a row, which fog that stays may deny it for 60 frames."""

    steps = 60
    noise_size = 2
    start = {"run": 0, "fog": False}
    clear, clear_in_fog, enter, leave = 0.9, 0.3, 0.001, 0.03
    formula = "eventually (run >= 6)"

    def step(self, state: State, noise: Floats) -> State:
        fog = switch(state["fog"], noise[:, 1], self.enter, self.leave)
        clear = noise[:, 0] > np.where(fog, threshold(self.clear_in_fog), threshold(self.clear))
        return {"run": np.where(clear, state["run"] + 1, 0), "fog": fog}

    def exact(self) -> float:
        def moves(state: tuple[int, bool]) -> Moves:
            run, fog = state
            change = self.leave if fog else self.enter
            for fog_after, share in ((fog, 1 - change), (not fog, change)):
                clear = self.clear_in_fog if fog_after else self.clear
                yield ((run + 1, fog_after) if run < 5 else None), share * clear
                yield (0, fog_after), share * (1 - clear)

        return 1 - failing((0, False), moves, self.steps)


class Redetect(Case):
    """A lost pedestrian has to be seen again within eight frames, but a loss makes the next one likelier."""

    steps = 58
    start = {"seen": True}
    first, again = 0.02, 0.35
    formula = "always[0:50 samples] (seen < 0.5 -> eventually[0:8 samples] (seen > 0.5))"

    def step(self, state: State, noise: Floats) -> State:
        return {"seen": noise[:, 0] <= np.where(state["seen"], threshold(self.first), threshold(self.again))}

    def exact(self) -> float:
        def moves(lost: int) -> Moves:
            share = self.again if lost else self.first
            yield (lost + 1 if lost < 8 else None), share
            yield 0, 1 - share

        return failing(0, moves, self.steps)


class PhantomBrake(Case):
    """A car may brake only if there was a danger in the last six frames, but it brakes for ghosts."""

    steps = 60
    noise_size = 2
    start = {"danger": False, "count": 0}
    danger, right, ghost = 0.04, 0.9, 0.015
    formula = "always (brake > 0.5 -> once[0:5 samples] (danger > 0.5))"

    def step(self, state: State, noise: Floats) -> State:
        danger = noise[:, 0] > threshold(self.danger)
        detected = noise[:, 1] > np.where(danger, threshold(self.right), threshold(self.ghost))
        return {"danger": danger, "count": np.clip(state["count"] + np.where(detected, 1, -1), 0, 4)}

    def signals(self, state: State) -> State:
        return {"danger": state["danger"], "brake": state["count"] >= 3}

    def exact(self) -> float:
        def moves(state: tuple[int, int]) -> Moves:
            count, since = state
            for danger, share in ((True, self.danger), (False, 1 - self.danger)):
                since_after = 0 if danger else min(since + 1, 6)
                detection = self.right if danger else self.ghost
                for change, chance in ((1, detection), (-1, 1 - detection)):
                    count_after = min(max(count + change, 0), 4)
                    fails = count_after >= 3 and since_after > 5
                    yield (None if fails else (count_after, since_after)), share * chance

        return failing((0, 6), moves, self.steps)


class SlowLeak(Case):
    """Brake fluid begins to leak, which nobody notices until an emergency stop asks for full pressure."""

    steps = 80
    noise_size = 2
    start = {"age": 0, "demand": 0.2}
    leak, stop = 1e-5, 0.01
    formula = "always (pressure > demand)"

    def step(self, state: State, noise: Floats) -> State:
        leaks = (state["age"] > 0) | (noise[:, 0] > threshold(self.leak))
        demand = np.where(noise[:, 1] > threshold(self.stop), 0.8, 0.2)
        return {"age": state["age"] + leaks, "demand": demand}

    def signals(self, state: State) -> State:
        return {"pressure": 1.0 - 0.015 * state["age"], "demand": state["demand"]}

    def exact(self) -> float:
        def moves(age: int) -> Moves:
            for leaks, share in ((True, self.leak), (False, 1 - self.leak)) if age == 0 else ((True, 1.0),):
                for demand, chance in ((0.8, self.stop), (0.2, 1 - self.stop)):
                    fails = 1.0 - 0.015 * (age + leaks) <= demand
                    yield (None if fails else age + leaks), share * chance

        return failing(0, moves, self.steps)


class Checksum(Case):
    """A damaged message passes its check where the checksum of its frames happens to be the right one."""

    steps = 12
    hidden = True
    start = {"sum": 1}
    prime, right = 65_521, 4_711
    edges = norm.ppf(np.arange(1, 8) / 8)
    formula = "always (passes < 0.5)"

    def step(self, state: State, noise: Floats) -> State:
        digit = np.searchsorted(self.edges, noise[:, 0])
        return {"sum": (state["sum"] * 31 + digit * 7_919 + 17) % self.prime}

    def signals(self, state: State) -> State:
        return {"passes": state["sum"] == self.right}

    def exact(self) -> float:
        shares = np.zeros(self.prime)
        shares[1] = 1.0
        sums = (np.arange(self.prime)[:, None] * 31 + np.arange(8) * 7_919 + 17) % self.prime
        failed = 0.0
        for _ in range(self.steps):
            shares = np.bincount(sums.ravel(), np.repeat(shares / 8, 8), self.prime)
            failed += shares[self.right]
            shares[self.right] = 0.0
        return float(failed)


class QuietFrame(Case):
    """Six channels that are all near zero in one frame look like a dead sensor, and the car shuts down."""

    steps = 30
    noise_size = 7
    hidden = True
    start = {"drift": 0.0, "alive": True}
    quiet, level = 0.17, 4.9
    formula = f"always (alive > 0.5 and drift < {level})"

    def step(self, state: State, noise: Floats) -> State:
        alive = np.any(np.abs(noise[:, :6]) > self.quiet, axis=1)
        return {"drift": 0.9 * state["drift"] + 0.436 * noise[:, 6], "alive": alive}

    def exact(self) -> float:
        def density(x: Floats, before: Floats, _: int) -> Floats:
            return bell(x, 0.9 * before, 0.436)

        dead = (ndtr(self.quiet) - ndtr(-self.quiet)) ** 6
        holds = survival(density, panels(-7.0, self.level, 0.5), 0.0, self.steps)[-1]
        return float(1 - (1 - dead) ** self.steps * holds)


class GlareSequence(Case):
    """Glare, a late exposure seven frames on and a reset four frames after that blind a camera."""

    steps = 40
    noise_size = 3
    hidden = True
    method = "closed form"
    start = {"glare": np.zeros(7, bool), "late": np.zeros(4, bool), "blind": False}
    low, high = 0.40, 0.46
    formula = "always (blind < 0.5)"

    def step(self, state: State, noise: Floats) -> State:
        inside = (noise > self.low) & (noise < self.high)
        late = inside[:, 1:2] & state["glare"][:, :1]
        return {
            "glare": np.concatenate([state["glare"][:, 1:], inside[:, :1]], axis=1),
            "late": np.concatenate([state["late"][:, 1:], late], axis=1),
            "blind": inside[:, 2] & state["late"][:, 0],
        }

    def exact(self) -> float:
        inside = ndtr(self.high) - ndtr(self.low)
        return float(1 - (1 - inside**3) ** (self.steps - 11))
