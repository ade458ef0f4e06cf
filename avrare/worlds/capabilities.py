"""Capabilities of systems, checked before an estimator that needs them runs.

| capability | needed by |
|---|---|
| ``branches`` | splitting: a rollout continues from the state of another one |
| ``noise`` | every method that draws the noise from another distribution, changes it or stores it |

A probe shows whether a system is a function of its state and its noise alone, and its state a value. Three
rows are run a few steps, and again: on the same noise, from a stored state, and one of them alone. The
numbers are the probe's own, and it leaves the global generators as they were: no result depends on it.
"""

from __future__ import annotations

import random
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import BuiltinFunctionType, FrameType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from avrare.base import batch
from avrare.base.errors import AvrareError, UsageError
from avrare.protocols import Floats, System, adapt
from avrare.worlds.world import NotDeterministic

STEPS = 10
"""Steps of the probe, which costs 7 rollouts of that length, and 1.5 more where it branches."""
_TAPES = (0, 1, 0)
"""Tape of each row: the third repeats the first."""

Samples = list[dict[str, Any]]
State = TypeVar("State")


@dataclass(frozen=True)
class Findings:
    """Descriptions of the rules that a system breaks; empty if it breaks none.

    Attributes:
        in_place: A step changes the state or the noise that it is given.
        differs: The same noise gives other signals.
        branches: A rollout that continues from a stored state gives other signals.
        rounding: The last digits of a row depend on the batch that it is in.
    """

    in_place: str = ""
    differs: str = ""
    branches: str = ""
    rounding: str = ""


def probe(system: System, steps: int = STEPS, *, branch: bool = True) -> Findings:
    """Run a few rows for ``steps`` steps, repeatedly; ``branch``: also from a stored state.

    The probe ends where a row raises: errors are counted where they occur in an estimate.
    """
    trial = _Trial(system, steps)
    with _restore_generators():
        try:
            trial.run(branch)
        except NotDeterministic as error:
            trial.found["branches"] = error.message
        except AvrareError:
            raise
        except (Exception, SystemExit):  # it is counted, with its message, where it occurs in an estimate
            pass
    return Findings(**trial.found)


@contextmanager
def _restore_generators() -> Iterator[None]:
    before = random.getstate(), np.random.get_state()
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield
    finally:
        random.setstate(before[0])
        np.random.set_state(before[1])


class _Trial:
    def __init__(self, system: System, steps: int) -> None:
        self.system, self.steps = system, steps
        tapes = np.random.default_rng(0).standard_normal((2, steps + 1, system.noise_size))
        self.tape = tapes[list(_TAPES)]
        self.found: dict[str, str] = {}

    def run(self, branch: bool) -> None:
        all_rows = np.arange(len(_TAPES))
        expected, copies = self._watch(all_rows, self._read_only_step)
        repeated, _ = self._watch(all_rows, self.system.step)
        if difference := _find_difference(expected, repeated):
            cause = _find_cause(lambda: self._samples(all_rows))
            self.found["differs"] = f"{difference} between two runs on the same noise ({cause})"
            return
        middle = self.steps // 2
        if branch and self.steps and (origin := copies[middle]) is not None:
            rest = self._samples(all_rows, middle, batch.take(origin, all_rows))
            difference = _find_difference(expected[middle + 1 :], rest, middle + 1)
            self._note("branches", difference, f"after a branch at step {middle} with the same noise")
        rows = [_find_difference(_rows(expected, 0), _rows(expected, 2))]
        rows.append(_find_difference(_rows(expected, 1), self._samples(all_rows[1:2])))
        for difference in rows:
            self._note("differs", difference, "with the other rows of its batch")

    def _watch(
        self, rows: NDArray[np.int64], step: Callable[[object, Floats], object]
    ) -> tuple[Samples, list[object]]:
        stored, samples = [], []
        for state in self._states(rows, step):
            stored.append((state, _copy(state)))
            samples.append(self._sample(state))
        if any(copy is not None and _has_changed(state, copy) for state, copy in stored):
            self.found.setdefault("in_place", "a step changes the state that it is given")
        return samples, [copy for _, copy in stored]

    def _note(self, name: str, difference: _Difference | None, when: str) -> None:
        if difference is not None:
            self.found.setdefault("rounding" if difference.small else name, f"{difference} {when}")

    def _states(
        self,
        rows: NDArray[np.int64],
        step: Callable[[object, Floats], object],
        t: int = -1,
        state: object = None,
    ) -> Iterator[object]:
        for now in range(t + 1, self.steps + 1):
            noise = np.ascontiguousarray(self.tape[rows, now])
            state = step(state, noise) if now else self.system.initial(noise)
            yield state

    def _samples(self, rows: NDArray[np.int64], t: int = -1, state: object = None) -> Samples:
        return [self._sample(state) for state in self._states(rows, self.system.step, t, state)]

    def _sample(self, state: object) -> dict[str, NDArray[np.generic]]:
        return {name: np.array(values) for name, values in self.system.signals(state).items()}

    def _read_only_step(self, state: object, noise: Floats) -> object:
        try:
            return self.system.step(_read_only(state), _read_only(noise))
        except ValueError as error:
            if "read-only" not in str(error):
                raise
            if "buffer source" not in str(error):  # Cython asks for writable arrays that it only reads
                place = _place(error)
                self.found["in_place"] = f"a step changes the state or the noise that it is given ({place})"
        return self.system.step(_copy(state), noise.copy())


def _read_only(state: State) -> State:
    def view(leaf: NDArray[np.generic]) -> NDArray[np.generic]:
        locked = leaf.view()
        locked.flags.writeable = False
        return locked

    with suppress(UsageError):  # no value that can be copied; only branches need that
        return batch.map_leaves(view, state)
    return state


def _copy(state: State) -> State | None:
    with suppress(UsageError):
        return batch.separate_leaves(state)
    return None


def _place(error: Exception) -> str:
    frames = traceback.extract_tb(error.__traceback__)
    frames_here = [frame for frame in frames if "numpy" not in Path(frame.filename).parts]
    return f"{Path(frames_here[-1].filename).name}:{frames_here[-1].lineno}"


def _has_changed(state: object, copy: object) -> bool:
    return not all(map(_same, batch.leaves(state), batch.leaves(copy)))


def _same(first: NDArray[np.generic], second: NDArray[np.generic]) -> bool:
    if first.dtype.kind == "O":
        return all(a is b for a, b in zip(first.flat, second.flat, strict=True))
    return np.array_equal(first, second, equal_nan=first.dtype.kind == "f")


def _rows(samples: Samples, row: int) -> Samples:
    return [{name: values[row : row + 1] for name, values in sample.items()} for sample in samples]


@dataclass(frozen=True)
class _Difference:
    signal: str  # which differs first
    step: int
    size: float
    small: bool

    def __str__(self) -> str:
        return f"signal {self.signal!r} differs from step {self.step} on by up to {self.size:.2g}"


def _find_difference(wanted: Samples, signals: Samples, since: int = 0) -> _Difference | None:
    steps: dict[str, int] = {}
    for t, (before, after) in enumerate(zip(wanted, signals, strict=True), since):
        for name in before:
            if not _same(before[name], after[name]):
                steps.setdefault(name, t)
    sizes = {}
    for name in steps:
        first, second = (
            np.array([before[name] for before in samples], dtype=float) for samples in (wanted, signals)
        )
        error = np.abs(first - second)[(first != second) & ~(np.isnan(first) & np.isnan(second))].max()
        sizes[name] = float(error), bool(error <= 1e-5 * np.nanmax(np.abs(first)))  # counts as rounding
    if not sizes:
        return None
    signal = next(iter(steps))
    return _Difference(signal, steps[signal], sizes[signal][0], all(small for _, small in sizes.values()))


def _find_cause(play: Callable[[], object]) -> str:
    """Describe which source of random numbers, or which clock, a run reads."""
    calls: dict[str, None] = {}

    def watch(frame: FrameType, event: str, called: object) -> None:
        label = _source(called) if event == "c_call" else ""
        while frame.f_back is not None and frame.f_globals.get("__name__") == "random":
            frame = frame.f_back
        if label:
            calls[f"{label} at {Path(frame.f_code.co_filename).name}:{frame.f_lineno}"] = None

    generator, profile = repr(np.random.get_state()), sys.getprofile()
    sys.setprofile(watch)
    try:
        play()
    finally:
        sys.setprofile(profile)
    if generator != repr(np.random.get_state()):
        calls["numpy.random"] = None
    if calls:
        return f"it reads {', '.join(list(calls)[:3])}"
    return "it keeps a state of its own, such as a random generator"


def _source(called: object) -> str:
    if not isinstance(called, BuiltinFunctionType):
        return ""
    owner, name = called.__self__, called.__name__
    if isinstance(owner, random.Random):
        return "the module random"
    if owner is time and name != "sleep":
        return f"time.{name}"
    return name if name in ("now", "today", "utcnow", "urandom") else ""


@dataclass(frozen=True)
class Capabilities:
    """Capabilities of a system.

    Attributes:
        branches: A rollout can continue from the state of another one.
        noise: The same noise gives the same rollout.
        reason: Reason why a capability is missing; empty where none is.
    """

    branches: bool
    noise: bool
    reason: str = ""


def capabilities(system: object, steps: int = STEPS) -> Capabilities:
    """Return the capabilities of ``system``, as its simulator declares (``lacks``) and as ``probe`` finds."""
    system = adapt(System, system)
    lacks = system.lacks or {}
    if "noise" not in lacks:
        findings = probe(system, steps)
        lacks = {**{name: text for name, text in _limits(findings).items() if text}, **lacks}
    reason = next(iter(lacks.values()), "")
    return Capabilities("branches" not in lacks, "noise" not in lacks, reason)


def refuse_limits(estimator: str, lacks: Mapping[str, str], needs: Collection[str]) -> None:
    """Raise a ``UsageError`` if an estimator of this name needs a missing capability."""
    missing = [need for need in needs if lacks.get(need)]
    if missing:
        wants = {"branches": "continue rollouts from others", "noise": "choose the noise of a rollout"}
        hint = "return new arrays from `step`, and derive every random choice from its noise"
        raise UsageError(
            f"{estimator} must {' and '.join(wants[need] for need in missing)}, which this system does not "
            f"allow: {lacks[missing[0]]}",
            f"{hint}; estimator: {{plugin: mc}} needs neither",
        )


def require(system: System, estimator: str, needs: Collection[str], steps: int = STEPS) -> dict[str, str]:
    """Refuse a system that lacks a capability that an estimator needs: "branches", "noise".

    "noise" is required of simulators that declare ``lacks``; of any other system a warning is enough.

    Returns:
        Reasons of the health warnings to give, by name: ``not_deterministic``, ``rounding``.
    """
    lacks = system.lacks or {}
    refuse_limits(estimator, lacks, needs)
    if "noise" in lacks:
        return {"not_deterministic": lacks["noise"]}
    findings = probe(system, steps, branch="branches" in needs)
    refuse_limits(estimator, _limits(findings), set(needs) - {"noise"} if system.lacks is None else needs)
    reasons = {"not_deterministic": findings.differs, "rounding": findings.rounding}
    return {name: reason for name, reason in reasons.items() if reason}


def _limits(findings: Findings) -> dict[str, str]:
    return {"noise": findings.differs, "branches": findings.in_place or findings.differs or findings.branches}
