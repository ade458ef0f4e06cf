"""Pictures of the failing runs: rewards, speeds, their noise by t-SNE, and one of them from above."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import avrare
from avrare.estimation.result.result import spread
from avrare_metadrive.config import DT, SIGNALS, NoiseConfig
from avrare_metadrive.world import MetaDriveWorld

Floats = NDArray[np.float64]
BEFORE = (30, 20, 10, 0)
"""Steps before the end that are drawn from above."""
MOST = 40
"""Failing tapes of an estimator that are driven again."""
SECOND = 10
"""Steps over which the pushes are averaged."""
KINDS = {"reward": "tab:red", "speed": "tab:blue", "both": "tab:purple"}
"""What a failing run lacks, and its colour."""
MARKERS = {"mc": "^", "ams": "s", "ess": "o"}
"""Estimators whose failing runs are drawn."""


@dataclass(frozen=True)
class Drives:
    """Failing tapes of one estimator, driven again.

    Attributes:
        noise: (F, steps + 1, rays).
        signals: (F, steps + 1, S) in the order of ``SIGNALS``; after its end a run stays as it was.
        pushes: (F, steps, 2) what the noise adds to steering and throttle.
        roots: (F,) first ancestor of each tape, from 0; of Monte Carlo each its own.
    """

    noise: Floats
    signals: Floats
    pushes: Floats
    roots: NDArray[np.int64]

    def signal(self, name: str) -> Floats:
        """Return a signal (F, steps + 1)."""
        return self.signals[:, :, SIGNALS.index(name)]

    def take(self, rows: Any) -> Drives:
        """Return some of the runs."""
        return Drives(self.noise[rows], self.signals[rows], self.pushes[rows], self.roots[rows])

    def kinds(self, least_speed: float, least_reward: float) -> NDArray[np.str_]:
        """Return what each run lacks: "reward", "speed", "both", or "nothing" if it fails no more."""
        windows = np.lib.stride_tricks.sliding_window_view(self.signal("speed")[:, 30:], 5, axis=1)
        slow = (windows.max(axis=2) < least_speed).any(axis=1)
        poor = self.signal("reward").max(axis=1) < least_reward
        return np.where(slow & poor, "both", np.where(slow, "speed", np.where(poor, "reward", "nothing")))


class _Watched(MetaDriveWorld):
    """World that remembers the rays before their noise."""

    def _see(self, numbers: Floats, noise: Floats) -> None:
        self.true = numbers[len(SIGNALS) :].copy()
        super()._see(numbers, noise)


def drive(world: Any, driver: Any, tape: Floats, drawn: Any = ()) -> tuple[Floats, Floats, dict[int, Any]]:
    """Return signals (T + 1, S), pushes (T, 2), and pictures of the steps in ``drawn``."""
    world.reset(tape[0])
    rows, pushes, pictures = [world.numbers()[: len(SIGNALS)]], [], {}
    for t, row in enumerate(tape[1:], start=1):
        action, _ = driver.act(None, world.observation()[None], None)
        push = action - driver.act(None, world.true[None], None)[0]
        pushes.append(np.where(rows[-1][-1], 0.0, push[0]))
        world.step(action[0], row)
        rows.append(world.numbers()[: len(SIGNALS)])
        if t in drawn:
            pictures[t] = world.picture(900, 150, 9.0)
    return np.array(rows), np.array(pushes), pictures


def read(world: Any, driver: Any, results: Path, name: str) -> Drives | None:
    """Drive the failing tapes of an estimator's parts; None where there are none."""
    noise, roots = [], []
    for k, file in enumerate(sorted(results.glob(f"{name}-*.npz"))):
        with np.load(file) as part:
            tapes, ancestors = part["noise"].astype(np.float64), part["ancestors"][:, 1]
        noise += list(tapes)
        roots += [(k, row) for row in (range(len(tapes)) if name == "mc" else ancestors)]
    if not noise:
        return None
    _, own = np.unique(np.array(roots), axis=0, return_inverse=True)
    chosen = spread(np.arange(len(noise)), MOST)
    found = [drive(world, driver, noise[k])[:2] for k in chosen]
    signals, pushes = (np.array(each) for each in zip(*found, strict=True))
    return Drives(np.array([noise[k] for k in chosen]), signals, pushes, own.ravel()[chosen])


def draw(scenario: Path, results: Path, folder: Path, least_speed: float, least_reward: float) -> None:
    """Write ``failures.png`` (as Fig. 10 of the paper), and ``failure.png`` (a run from above, as Fig. 9)."""
    study = avrare.load(scenario)
    config: Any = study.definition.blocks["simulator"].config
    world, driver = _Watched(config), study.stack.loop.controller
    quiet = _Watched(config.model_copy(update={"noise": NoiseConfig()}))
    calm, _, _ = drive(quiet, driver, np.zeros((study.steps + 1, 0)))
    found = {name: read(world, driver, results, name) for name in MARKERS}
    known, kinds = {}, {}
    for name, drives in found.items():
        lacks = drives.kinds(least_speed, least_reward) if drives is not None else np.array([])
        failing = lacks != "nothing"
        print(f"{name}: {failing.sum()} of {len(lacks)} tapes that were driven again fail")
        if drives is not None and failing.any():
            known[name], kinds[name] = drives.take(failing), lacks[failing]
    for name, drives in known.items():
        _tell(name, drives, kinds[name])
    folder.mkdir(parents=True, exist_ok=True)
    _figure(calm, known, kinds, (least_speed, least_reward), folder / "failures.png")
    _top_views(world, driver, next(iter(known.values())), folder / "failure.png")


def _tell(name: str, drives: Drives, kinds: NDArray[np.str_]) -> None:
    from sklearn.metrics import silhouette_score

    counts = {kind: int((kinds == kind).sum()) for kind in KINDS}
    crashed, roots = int(drives.signal("crashed")[:, -1].sum()), len(np.unique(drives.roots))
    print(f"{name}: {len(kinds)} failing runs of {roots} first tapes lack {counts}; {crashed} collide")
    raw, pushed = _raw(drives), _pushes(drives)
    for label, groups in (("kinds", kinds), ("first tapes", drives.roots)):
        if 1 < len(np.unique(groups)) < len(groups):
            worth = silhouette_score(raw, groups), silhouette_score(pushed, groups)
            print(f"  silhouette of the {label}: raw noise {worth[0]:.2f}, pushes {worth[1]:.2f}")


def _raw(drives: Drives) -> Floats:
    return drives.noise.reshape(len(drives.noise), -1)


def _pushes(drives: Drives) -> Floats:
    """Return (F, 2 T / SECOND) means over each second, in standard deviations."""
    count, steps, actions = drives.pushes.shape
    means = drives.pushes.reshape(count, steps // SECOND, SECOND, actions).mean(axis=2).reshape(count, -1)
    return np.asarray((means - means.mean(axis=0)) / np.maximum(means.std(axis=0), 1e-9))


def _embed(points: Floats) -> Floats:
    from sklearn.manifold import TSNE

    perplexity = min(30.0, (len(points) - 1) / 3.0)
    return np.asarray(TSNE(perplexity=perplexity, random_state=0).fit_transform(points))


def _figure(
    calm: Floats,
    known: dict[str, Drives],
    kinds: dict[str, NDArray[np.str_]],
    least: tuple[float, float],
    path: Path,
) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 6.4), layout="constrained")
    (left, right), lower = figure.subplots(2, 2)
    time = DT * np.arange(len(calm))
    for axes, name, label, limit in (
        (left, "reward", "cumulative reward", least[1]), (right, "speed", "speed [m/s]", least[0]),
    ):  # fmt: skip
        for estimator, drives in known.items():
            for values, kind in zip(drives.signal(name), kinds[estimator], strict=True):
                axes.plot(time, values, color=KINDS[kind], alpha=0.5, lw=0.8)
        axes.plot(time, calm[:, SIGNALS.index(name)], color="black", lw=1.2, label="without noise")
        axes.axhline(limit, color="gray", ls=":", lw=1.0)
        axes.set(xlabel="time [s]", ylabel=label)
    for kind, colour in KINDS.items():
        right.plot([], [], color=colour, label=f"lacks {kind}")
    right.legend(frameon=False, fontsize=8)
    for axes, title in zip(lower, ("noise", "what the noise adds to the actions"), strict=True):
        features = _raw if title == "noise" else _pushes
        points = np.concatenate([features(drives) for drives in known.values()])
        ends = np.cumsum([len(drives.noise) for drives in known.values()])
        places = iter(np.split(_embed(points), ends[:-1]))
        for (name, drives), place in zip(known.items(), places, strict=True):
            _scatter(axes, place, kinds[name], drives.roots, MARKERS[name])
        axes.set_title(f"t-SNE of the {title}" if title == "noise" else f"t-SNE of {title}", fontsize=9)
        axes.set(xticks=[], yticks=[])
    figure.savefig(path, dpi=90)


def _scatter(
    axes: Any, place: Floats, kinds: NDArray[np.str_], roots: NDArray[np.int64], marker: str
) -> None:
    """Draw points by kind; a line joins those that descend from one first tape."""
    for root in np.unique(roots):
        chosen = place[roots == root]
        centre = chosen.mean(axis=0)
        for point in chosen:
            axes.plot(*zip(centre, point, strict=True), color="lightgray", lw=0.6, zorder=0)
    for kind, colour in KINDS.items():
        axes.scatter(*place[kinds == kind].T, s=18, color=colour, marker=marker)


def _top_views(world: Any, driver: Any, drives: Drives, path: Path) -> None:
    from matplotlib.figure import Figure

    first = int(drives.signal("speed")[:, 30:].min(axis=1).argmin())  # the slowest of them
    speed, over = (drives.signal(name)[first] for name in ("speed", "over"))
    slowest = 30 + int(speed[30:].argmin())
    last = min(slowest + BEFORE[1], int(np.argmax(over)) if over.any() else len(speed) - 1)
    _, _, pictures = drive(world, driver, drives.noise[first], [last - k for k in BEFORE])
    figure = Figure(figsize=(9.0, 1.75 * len(pictures)), layout="constrained")
    for axes, (t, picture) in zip(figure.subplots(len(pictures)), pictures.items(), strict=True):
        axes.imshow(picture)
        axes.set_axis_off()
        axes.set_title(f"{DT * t:.1f} s, {speed[t]:.1f} m/s", fontsize=9, loc="left")
    figure.savefig(path, dpi=90)
