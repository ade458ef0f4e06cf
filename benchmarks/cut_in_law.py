"""Law of motorway cut-ins, fitted to the 297 that TNO recorded in 63 hours (E. de Gelder, MIT licence).

    python -m benchmarks.cut_in_law cut_ins.csv --out docs/regulation

The file has a row for each cut-in: gap, speeds and highest lateral speed at the middle of the lane change
(data/scenarios/cut-in.json of ErwindeGelder/ScenarioRiskQuantification, 627aa1e). ``law.csv`` has each
number of the scenarios ``motorway_cut_in*.yaml`` with its 95 % bootstrap interval, ``law_fit.csv`` quantiles
of data and law.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import minimize

Floats = NDArray[np.float64]
HOURS = 63.0
SCATTER = 3.6
"""Variance of the hourly counts of all cut-ins, over their mean."""
SLOW = 15.0
"""Speed of the ego below which traffic is slow [m/s]."""
GAPS = (0.5, 66.0)
"""Bounds of the law of gaps [m]."""
FASTEST_LATERAL = 4.0
"""Lateral speed above which a fit to a short piece of a lane change is left out [m/s]."""
REPEATS = 200
"""Bootstrap samples."""
QUANTILES = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)


def read_scenes(path: str) -> dict[str, dict[str, Floats]]:
    """Return gap, ego speed, closing speed and lateral speed of each scene's cut-ins."""
    with open(path) as file:
        rows = list(csv.DictReader(file))
    column = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
    ego, other = column["ego_speed_mps"], column["other_speed_mps"]
    # a car that goes backwards while it moves aside at 2.3 m/s is an error of the measurement
    sound = ~((other < 0.0) & (column["mean_lateral_speed_mps"] > 1.0))
    left, fast = column["to_the_left"] == 1.0, ego >= SLOW
    values = {
        "Gap": column["gap_m"],
        "EgoSpeed": ego,
        "Closing": ego - other,
        "LateralSpeed": column["peak_lateral_speed_mps"],
    }
    rows_of = {"from_the_right": left & fast, "from_the_left": ~left & fast, "slow_traffic": ~fast}
    return {
        scene: {name: value[chosen & sound] for name, value in values.items()}
        for scene, chosen in rows_of.items()
    }


def fit(cut_ins: dict[str, Floats]) -> dict[str, float]:
    """Return the numbers of a scene's law, by name."""
    gap, ego, closing, lateral = cut_ins.values()
    mean, sd = _fit_truncated(gap)
    found = {"Gap.mean": mean, "Gap.sd": sd, "EgoSpeed.mean": ego.mean(), "EgoSpeed.sd": ego.std(ddof=1)}
    if len(gap) > 50:
        found |= _fit_two_normals(closing)
    else:
        found |= {"Closing.mean": closing.mean(), "Closing.sd": closing.std(ddof=1)}
    logs = np.log(lateral[lateral < FASTEST_LATERAL])
    law = stats.lognorm(logs.std(ddof=1), scale=np.exp(logs.mean()))
    found |= {"LateralSpeed.mean": law.mean(), "LateralSpeed.sd": law.std()}
    scores = stats.norm.ppf(stats.rankdata([gap, ego, closing], axis=1) / (len(gap) + 1.0))
    (_, *first), (_, _, last), _ = np.corrcoef(scores)
    pairs = ("Gap-EgoSpeed", "Gap-Closing", "EgoSpeed-Closing")
    return found | dict(zip(pairs, (*first, last), strict=True))


def _fit_truncated(gap: Floats) -> tuple[float, float]:
    def surprise(theta: Floats) -> float:
        mean, sd = theta[0], np.exp(theta[1])
        low, high = ((end - mean) / sd for end in GAPS)
        return -float(stats.truncnorm.logpdf(gap, low, high, mean, sd).sum())

    best = minimize(surprise, [gap.mean(), np.log(gap.std())], method="Nelder-Mead").x
    return float(best[0]), float(np.exp(best[1]))


def _fit_two_normals(closing: Floats) -> dict[str, float]:
    # expectation and maximisation; the main part first
    weight, mean = np.array([0.9, 0.1]), np.full(2, np.median(closing))
    sd = closing.std() * np.array([0.8, 2.0])
    for _ in range(500):
        parts = weight * stats.norm.pdf(closing[:, None], mean, sd)
        parts /= parts.sum(axis=1, keepdims=True)
        size = parts.sum(axis=0)
        weight, mean = size / len(closing), (parts * closing[:, None]).sum(axis=0) / size
        sd = np.sqrt((parts * (closing[:, None] - mean) ** 2).sum(axis=0) / size) + 0.05
    order = np.argsort(-weight)
    names = ("main", "rest")
    return {"Closing.weight": float(weight[order[0]])} | {
        f"Closing.{name}.{number}": float(values[k])
        for name, k in zip(names, order, strict=True)
        for number, values in (("mean", mean), ("sd", sd))
    }


def describe_law(numbers: dict[str, float], name: str) -> Floats:
    """Return the quantiles of a law, without the scenarios' bounds on it."""
    if name == "LateralSpeed":
        ratio = 1.0 + (numbers["LateralSpeed.sd"] / numbers["LateralSpeed.mean"]) ** 2
        scale = numbers["LateralSpeed.mean"] / np.sqrt(ratio)
        return np.asarray(stats.lognorm.ppf(QUANTILES, np.sqrt(np.log(ratio)), scale=scale))
    if "Closing.weight" in numbers and name == "Closing":
        grid, weight = np.linspace(-30.0, 30.0, 60_001), numbers["Closing.weight"]
        main, rest = (
            stats.norm.cdf(grid, numbers[f"Closing.{part}.mean"], numbers[f"Closing.{part}.sd"])
            for part in ("main", "rest")
        )
        return np.interp(QUANTILES, weight * main + (1.0 - weight) * rest, grid)
    mean, sd = numbers[f"{name}.mean"], numbers[f"{name}.sd"]
    if name == "Gap":
        return np.asarray(stats.truncnorm.ppf(QUANTILES, *((end - mean) / sd for end in GAPS), mean, sd))
    return np.asarray(stats.norm.ppf(QUANTILES, mean, sd))


def main() -> None:
    """Fit, and write both tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("file")
    parser.add_argument("--out", type=Path, default=Path())
    args = parser.parse_args()
    rng, numbers_rows, fit_rows = np.random.default_rng(0), [], []
    scenes = read_scenes(args.file)
    for scene, cut_ins in scenes.items():
        count = len(cut_ins["Gap"])
        scatter = 1.0 + (SCATTER - 1.0) * count / sum(len(one["Gap"]) for one in scenes.values())
        rate = [float(stats.gamma.ppf(q, count / scatter + 0.5)) * scatter / HOURS for q in (0.025, 0.975)]
        numbers_rows.append((scene, "per_hour", count / HOURS, *rate))
        numbers, repeats = fit(cut_ins), []
        for _ in range(REPEATS if count > 50 else 0):
            again = rng.integers(count, size=count)
            repeats.append(fit({name: values[again] for name, values in cut_ins.items()}))
        for name, value in numbers.items():
            ends = np.quantile([one[name] for one in repeats], (0.025, 0.975)) if repeats else ("", "")
            numbers_rows.append((scene, name, value, *ends))
        for name, values in cut_ins.items():
            seen = values[values < FASTEST_LATERAL] if name == "LateralSpeed" else values
            fit_rows.append((scene, name, "data", *np.quantile(seen, QUANTILES)))
            fit_rows.append((scene, name, "law", *describe_law(numbers, name)))
    for name, heads, rows in (
        ("law.csv", ("scene", "number", "value", "low", "high"), numbers_rows),
        ("law_fit.csv", ("scene", "value", "of", *(f"{100 * q:g} %" for q in QUANTILES)), fit_rows),
    ):
        with open(args.out / name, "w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(heads)
            writer.writerows([x if isinstance(x, str) else f"{x:.3g}" for x in row] for row in rows)


if __name__ == "__main__":
    main()
