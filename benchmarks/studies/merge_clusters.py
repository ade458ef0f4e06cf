"""Clusters of the failures of the merge study: their noise, projected, clustered and drawn.

A tape has 48,000 numbers, and failing tapes are as far from each other as any two tapes are. What matters of
them is what they do to the actions: at every step the network's action on the noisy rays less that on the
true ones. Its means over each second, throttle and steering apart, are 40 numbers a run; they are divided by
their standard deviations over ordinary runs, reduced by principal components and clustered by k-means.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import KMeans
from sklearn.metrics import silhouette_score

import avrare
from avrare.base import batch
from avrare_highway_env.render import frames, roll
from avrare_highway_env.sensing import Sensors

Floats = NDArray[np.float64]
SECOND = 10
"""Steps."""
COMPONENTS, MOST, SHOWN = 4, 4, 5
"""Principal components, clusters tried at most, top views of a picture."""
EACH, ORDINARY = 40, 24
"""Failing tapes at most, and tapes of ordinary runs to compare them with."""
GRACE, THRESHOLD = 30, 19.8
"""Of the scenario's formula [steps, m/s]."""


@dataclass(frozen=True)
class Runs:
    """Runs of the closed loop.

    Attributes:
        pushes: (F, T, 2) what the noise does to throttle and steering.
        speed: (F, T + 1) [m/s].
        x: (F, T + 1) [m].
        y: (F, T + 1) [m].
        over: (F, T + 1) crashed or arrived.
        crashed: (F,).
    """

    pushes: Floats
    speed: Floats
    x: Floats
    y: Floats
    over: NDArray[np.bool_]
    crashed: NDArray[np.bool_]


def drive(loop: Any, tapes: Floats) -> Runs:
    """Drive the tapes (F, T + 1, noise_size) and note what their noise does."""
    simulator, network = loop.simulator, loop.controller.network
    clear = Sensors(simulator.config.lidar.model_copy(update={"noise_variance": 0.0}))
    sizes = simulator.scene.lengths, simulator.scene.widths
    state, pushes, noted = loop.initial(tapes[:, 0]), [], []
    for t in range(tapes.shape[1]):
        ego = state.world.ego
        noted.append((ego.speed, ego.x, ego.y, state.world.over))
        if t + 1 == tapes.shape[1]:
            break
        truth = clear.observe(ego, ego.steering, state.world.others, *sizes, np.zeros((len(tapes), 0)))
        push = network(ego.observation) - network(truth.observation)
        pushes.append(np.where(state.world.over[:, None], 0.0, push))
        state = loop.step(state, tapes[:, t + 1])
    speed, x, y, over = (np.stack(series, axis=1) for series in zip(*noted, strict=True))
    return Runs(np.stack(pushes, axis=1), speed, x, y, over.astype(bool), state.world.crashed)


def features(runs: Runs) -> Floats:
    """Return (F, 40) means of the pushes over each second."""
    count, steps, kinds = runs.pushes.shape
    seconds = runs.pushes.reshape(count, steps // SECOND, SECOND, kinds).mean(axis=2)
    return np.asarray(seconds.reshape(count, -1))


def components(values: Floats, count: int = COMPONENTS) -> tuple[Floats, Floats]:
    """Return the first principal components (F, count) and each one's share of the variance."""
    centred = values - values.mean(axis=0)
    left, sizes, _ = np.linalg.svd(centred, full_matrices=False)
    return left[:, :count] * sizes[:count], (sizes**2 / (sizes**2).sum())[:count]


def k_means(points: Floats, k: int) -> NDArray[np.int64]:
    """Return (F,) labels of the best of several starts, the largest cluster first."""
    labels = KMeans(k, n_init=20, random_state=0).fit_predict(points)
    return np.argsort(np.argsort(-np.bincount(labels, minlength=k)))[labels]


def best_labels(points: Floats) -> tuple[NDArray[np.int64], dict[int, float]]:
    """Return the labels with the greatest silhouette, and the silhouette of each number of clusters."""
    tried = {k: k_means(points, k) for k in range(2, MOST + 1)}
    worth = {k: float(silhouette_score(points, labels)) for k, labels in tried.items()}
    return tried[max(worth, key=lambda k: worth[k])], worth


def slowest(runs: Runs) -> NDArray[np.int64]:
    """Return (F,) the step after the grace at which the fastest of five samples is least."""
    return np.asarray(GRACE + _fastest_of_five(runs).argmin(axis=1))


def fails(runs: Runs) -> NDArray[np.bool_]:
    """Return (F,) the scenario's formula."""
    too_slow = (_fastest_of_five(runs) < THRESHOLD).any(axis=1)
    return too_slow | ~runs.over[:, -1] | runs.crashed


def _fastest_of_five(runs: Runs) -> Floats:
    windows = np.lib.stride_tricks.sliding_window_view(runs.speed[:, GRACE:], 5, axis=1)
    return np.asarray(windows.max(axis=2))


def draw(scenario: Path, run: Path, folder: Path) -> None:
    """Cluster the failing tapes of a run by Monte Carlo, and draw each cluster."""
    problem = avrare.load(scenario).problem("keeps_up")
    loop = problem.system
    noise = np.load(run / "failures.npz")["keeps_up.noise"][:EACH].astype(float)
    ordinary = np.random.default_rng(0).standard_normal((ORDINARY, problem.steps + 1, problem.noise_size))
    usual, runs = drive(loop, ordinary), drive(loop, noise)
    failing = fails(runs)
    noise, runs = noise[failing], batch.take(runs, failing)
    print(f"{failing.sum()} of {len(failing)} kept tapes fail when driven again, {fails(usual).sum()} others")
    scale = np.maximum(features(usual).std(axis=0), 1e-4)
    points, shares = components((features(runs) - features(usual).mean(axis=0)) / scale)
    labels, worth = best_labels(points)
    raw, _ = components(noise.reshape(len(noise), -1))
    print("silhouettes", worth, "of the raw noise", best_labels(raw)[1], "shares", shares.round(3))
    folder.mkdir(parents=True, exist_ok=True)
    _chart(folder / "clusters.png", points, labels, runs, usual)
    for kind in range(int(labels.max()) + 1):
        members = np.flatnonzero(labels == kind)
        _describe(kind, members, runs, usual)
        inner = ((points[members] - points[members].mean(axis=0)) ** 2).sum(axis=1)
        middle = int(members[inner.argmin()])
        _top_views(folder / f"cluster_{kind + 1}.png", loop, noise[middle], int(slowest(runs)[middle]))


def _describe(kind: int, members: Any, runs: Runs, usual: Runs) -> None:
    when = slowest(batch.take(runs, members))
    excess = features(batch.take(runs, members)).mean(axis=0) - features(usual).mean(axis=0)
    z = excess / np.maximum(features(usual).std(axis=0), 1e-4)
    throttle, steering = z.reshape(-1, 2).T
    print(f"cluster {kind + 1}: {len(members)} runs, crashed {int(runs.crashed[members].sum())}")
    print(
        f"  slowest at step {np.quantile(when, [0.1, 0.5, 0.9])}, x {np.median(runs.x[members, when]):.0f} m"
    )
    print("  throttle z by second", throttle.round(1).tolist())
    print("  steering z by second", steering.round(1).tolist())


def _chart(path: Path, points: Floats, labels: Any, runs: Runs, usual: Runs) -> None:
    """Draw components, speeds and pushes, one colour a cluster."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    colours = ["#0072b2", "#d55e00", "#009e73", "#cc79a7"]
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(13, 3.8), layout="constrained")
    time = 0.1 * np.arange(runs.speed.shape[1])
    middle.plot(time, np.where(usual.over, np.nan, usual.speed)[:40].T, color="0.8", lw=0.5)
    for kind in range(int(labels.max()) + 1):
        mine, colour = labels == kind, colours[kind]
        left.scatter(*points[mine, :2].T, s=18, color=colour, label=f"cluster {kind + 1}")
        speed = np.where(runs.over[mine], np.nan, runs.speed[mine])
        middle.plot(time, speed.T, color=colour, lw=0.6, alpha=0.6)
        push = runs.pushes[mine, :, 0].mean(axis=0) - usual.pushes[:, :, 0].mean(axis=0)
        right.plot(
            time[1:], np.convolve(push, np.ones(5) / 5, "same"), color=colour, label=f"cluster {kind + 1}"
        )
    middle.axhline(THRESHOLD, color="black", lw=0.8, ls=":")
    middle.set(xlim=(0, 17), ylim=(18.5, 30), xlabel="time [s]", ylabel="speed [m/s]")
    middle.set_title("speed; grey: ordinary runs", fontsize=10)
    left.set(xlabel="first component", ylabel="second component")
    left.set_title("what the noise does to the actions", fontsize=10)
    left.legend(fontsize=7)
    right.axhline(0.0, color="black", lw=0.6)
    right.set(xlim=(0, 16), xlabel="time [s]", ylabel="extra throttle")
    right.set_title("mean push on the throttle, above that of ordinary runs", fontsize=10)
    right.legend(fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _top_views(path: Path, loop: Any, tape: Floats, worst: int) -> None:
    """Draw the run's top views up to a little after its slowest step, one below the other."""
    from PIL import Image, ImageDraw

    worlds = roll(loop, tape)
    last = min(worst + 8, len(worlds) - 1)
    steps = sorted({*np.linspace(0, last, SHOWN - 1).round().astype(int).tolist(), worst})
    views = [frames(loop.simulator, [worlds[step]])[0] for step in steps]
    height, width, _ = views[0].shape
    picture = Image.new("RGB", (width, (height + 16) * len(views)), "white")
    pen = ImageDraw.Draw(picture)
    for k, (step, view) in enumerate(zip(steps, views, strict=True)):
        speed, x = worlds[step].ego.speed[0], worlds[step].ego.x[0]
        mark = "   slowest" if step == worst else ""
        pen.text(
            (4, k * (height + 16) + 2), f"{0.1 * step:.1f} s   x {x:.0f} m   {speed:.1f} m/s{mark}", "black"
        )
        picture.paste(Image.fromarray(view), (0, k * (height + 16) + 16))
    picture.save(path)


def bare_merge(options: dict[str, Any]) -> Any:
    """Return highway-env's merge with nothing changed but what continuous actions need."""
    from highway_env.envs.merge_env import ConnectedLaneMergeEnv

    from avrare_highway_env.scenes import Steered

    return type("BareMerge", (Steered, ConnectedLaneMergeEnv), {})(options)
