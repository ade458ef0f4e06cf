"""N worlds that each know only themselves, as one simulator."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from avrare import batch
from avrare.errors import UsageError, did_you_mean
from avrare.protocols import Floats, Signals
from avrare.worlds.branches import Branches
from avrare.worlds.fleet import Fleet
from avrare.worlds.readout import readout
from avrare.worlds.timeout import Watch
from avrare.worlds.track import Track
from avrare.worlds.world import Copy, World


@dataclass(frozen=True)
class WorldState:
    """N worlds at one step each. It holds inputs and outcomes; the worlds themselves stay in their process.

    Attributes:
        step: (N,) steps since the reset.
        track: (N,) objects: whose first ``step`` steps brought the row where it is.
        signals: By name, (N, ...).
        seen: (N, d) what the controller sees.
        replayed: (N,) steps that were driven again to come to where rows branch; 0 with copies.
    """

    step: NDArray[np.int64]
    track: NDArray[Any]
    signals: dict[str, Floats]
    seen: Floats
    replayed: NDArray[np.int64]

    @property
    def ego(self) -> Floats:
        """What a controller acts on: ``seen``."""
        return self.seen


class Worlds:
    """A simulator (``avrare.protocols.Simulator``) of worlds that ``make`` makes.

    A row that branches gets a world of its own. By ``replay`` that is reset and driven along the same inputs
    again. By ``deepcopy`` or ``hook`` (the world's own ``snapshot`` and ``restore``) the place is copied that
    others branched from before; in a process that has no copy yet it is driven to. What comes out is the
    same, whichever is chosen and however many processes there are.

    Args:
        make: Makes a world, such as its class; must survive pickling to be used in worker processes.
        dt: Step [s]; formulas in seconds use it.
        copy: "replay", "deepcopy" or "hook".
        step_timeout: Wall-clock seconds that a reset or a step may take before its rollout counts as broken
            down; None: no limit. Choose it so large that only what hangs runs into it.
        reuse: Whether a world is reset for the next rollout; else each gets a new one.

    Attributes:
        noise_size: Of a world.
        lacks: What it cannot do, with the reason (``avrare.worlds.capabilities``), as its worlds say.

    Raises:
        UsageError: An argument does not fit.
    """

    def __init__(
        self,
        make: Callable[[], World],
        *,
        dt: float = 1.0,
        copy: Copy = "replay",
        step_timeout: float | None = None,
        reuse: bool = True,
    ) -> None:
        if copy not in get_args(Copy):
            raise UsageError(
                f"copy must be one of the known ways, not {copy!r}", did_you_mean(copy, get_args(Copy))
            )
        if not callable(make):
            raise UsageError(
                f"worlds are made by calling a class or a function, not {type(make).__name__} objects",
                f"hand over what makes a world: {type(make).__name__}, not {type(make).__name__}()",
            )
        if step_timeout is not None and not 0.0 < step_timeout < 1e6:
            raise UsageError(f"step_timeout must be a positive number of seconds, not {step_timeout!r}")
        self.settings = make, dt, copy, step_timeout, reuse
        self.dt = dt
        self._fleet = Fleet(make, copy, reuse)
        self._watch = Watch(step_timeout)
        first: Any = _checked(make(), copy)
        self.noise_size = int(first.noise_size)
        self.lacks: dict[str, str] = dict(getattr(first, "lacks", {}))
        self._prepare = getattr(first, "prepare", None)
        self._readout = readout(first)
        self._branches = Branches(self._fleet, self._watch, self._readout)
        self._fleet.put_away(first)

    def __reduce__(self) -> tuple[Any, ...]:
        return _again, (type(self), *self.settings)

    def reset(self, noise: Floats) -> WorldState:
        """Worlds at t = 0 from noise (N, noise_size)."""
        self._fleet.recall(len(noise), keep=())
        with self._watch:
            tracks = [self._start(row) for row in _frozen(noise)]
        zeros = np.zeros(len(noise), dtype=np.int64)
        return self._state(zeros, tracks, zeros)

    def step(self, world: WorldState, action: Any, noise: Floats) -> WorldState:
        """Worlds one step later; ``action`` is an array with leading axis N, or None.

        Raises:
            NotDeterministic: The same inputs do not bring a world to where it was.
        """
        if self._prepare is not None:
            action = self._prepare(action, noise)
        at, tracks = world.step.tolist(), world.track.tolist()
        inputs = list(zip(_rows(action, len(at)), _frozen(noise), strict=True))
        replayed, called = world.replayed.copy(), False
        with self._watch:
            for i, (track, t, given) in enumerate(zip(tracks, at, inputs, strict=True)):
                if track.world is None or len(track.actions) != t:
                    if track.was(t, *given):
                        _remind(track)
                        continue
                    if not called:
                        called = self._call(tracks, at, inputs)
                    replayed[i] += t if len(track.actions) > t and self._fleet.copying == "replay" else 0
                    tracks[i] = track = self._branches.brought(
                        track, t, batch.take(world.signals, slice(i, i + 1))
                    )
                self._advance(track, *given)
                if self._branches.untried and t in track.copies:
                    self._branches.try_copy(track, t, given)
        return self._state(world.step + 1, tracks, replayed)

    def signals(self, world: WorldState) -> Signals:
        """What the worlds gave, (N, ...) each."""
        return world.signals

    def counts(self, world: WorldState) -> dict[str, NDArray[np.int64]]:
        """``replayed_steps`` (N,): see ``WorldState``."""
        return {"replayed_steps": world.replayed} if self._fleet.copying == "replay" else {}

    def _call(self, tracks: list[Track], at: list[int], inputs: list[tuple[Any, Floats]]) -> bool:
        """Take back as many worlds as rows need another, from tracks that nobody here goes on along."""
        keep, needed = set(), 0
        for track, t, given in zip(tracks, at, inputs, strict=True):
            if (track.world is not None and len(track.actions) == t) or track.was(t, *given):
                keep.add(track)
            else:
                needed += 1
        self._fleet.recall(needed, keep)
        return True

    def _start(self, noise: Floats) -> Track:
        track = Track([noise], [])
        try:
            world = self._fleet.lend(track)
            self._watch.call(world.reset, noise)
            track.latest = self._watch.call(self._readout.one, world)
        except (Exception, SystemExit) as error:
            raise self._broken(track, error) from error
        return track

    def _advance(self, track: Track, action: Any, noise: Floats) -> None:
        """One step. What it raises is known from then on: it is not tried again."""
        track.latest = None
        track.actions.append(action)
        track.noise.append(noise)
        world: Any = track.world
        try:
            if self._watch.seconds is None:  # two calls fewer, of a few that every step has
                world.step(action, noise)
                track.latest = self._readout.one(world)
            else:
                self._watch.call(world.step, action, noise)
                track.latest = self._watch.call(self._readout.one, world)
        except (Exception, SystemExit) as error:
            raise self._broken(track, error) from error

    def _broken(self, track: Track, error: BaseException) -> Exception:
        self._fleet.scrap(track)
        track.fault = error if isinstance(error, Exception) else RuntimeError(f"the world exits: {error}")
        return track.fault

    def _state(self, step: NDArray[np.int64], tracks: list[Track], replayed: NDArray[np.int64]) -> WorldState:
        column = np.empty(len(tracks), dtype=object)
        column[:] = tracks
        return WorldState(step, column, *self._readout.all([track.latest for track in tracks]), replayed)


def _remind(track: Track) -> None:
    """What came of the newest step, where that was a breakdown."""
    if track.fault is not None:
        raise track.fault


def _rows(action: Any, n: int) -> Iterator[Any] | Sequence[None]:
    if action is None:
        return [None] * n
    if not isinstance(action, np.ndarray) or len(action) != n:
        raise UsageError(
            f"the controller gave {type(action).__name__}, but worlds of their own take one row each",
            f"a controller for this simulator returns an array with leading axis {n}",
        )
    return iter(_frozen(action))


def _frozen(values: NDArray[Any]) -> NDArray[Any]:
    """A view that cannot be written to: a track keeps its rows."""
    view = values.view()
    view.flags.writeable = False
    return view


def _checked(world: Any, copy: Copy) -> World:
    needed = ["noise_size", "reset", "step", "signals"]
    missing = [
        name for name in needed + ["snapshot", "restore"] * (copy == "hook") if not hasattr(world, name)
    ]
    if missing:
        raise UsageError(
            f"{type(world).__name__} is no world: it lacks {', '.join(missing)}",
            "a world has noise_size, reset(noise), step(action, noise) and signals(); for copy: hook also "
            "snapshot() and restore(snapshot)",
        )
    return world  # type: ignore[no-any-return]


def _again(
    kind: type[Worlds], make: Any, dt: float, copy: Copy, step_timeout: float | None, reuse: bool
) -> Worlds:
    """What ``Worlds.__reduce__`` has stored: the recipe, without any world."""
    return kind(make, dt=dt, copy=copy, step_timeout=step_timeout, reuse=reuse)
