"""Is the riccati backend of the controller `mpc` the controller that the casadi backend is, and how fast?

    OMP_NUM_THREADS=1 python benchmarks/mpc.py [SCENARIO] [--rollouts 60] [--set KEY=VALUE ...]
    OMP_NUM_THREADS=1 python benchmarks/mpc.py [SCENARIO] --paired 5000 [--pair casadi ipopt]
        [--set KEY=VALUE ...]

The first form drives lane changes with the casadi backend and solves every programme of every later step
again from the same warm start: by ipopt to a tolerance of 1e-9 (the reference), by the casadi backend's
solver, and by the riccati backend. "Same" is a cost within 1e-3 of the reference, absolutely or relatively;
"better" is lower; "lost" is a plan that is said to be found and leaves a hard bound.

The second form drives each noise tape with both backends (or with ipopt instead of fatrop, which shows how
far two solvers of the same kind part) and compares their failures of each rule: pairs on
which they differ, and McNemar's exact test. It works in blocks, each a file in the results folder, named
after the scenario's fingerprint; what is there is not run again: it may be stopped and resumed, and blocks
of 250 may be shared out, or compared in part, with --first and --last. The fingerprint knows options and
versions, not the solver's code: after a change of that, use another folder.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from avrare.rollout.engine import simulate
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.load import load
from avrare.scenario.schema import Scenario
from avrare_mpc.casadi_search import NlpSolver
from avrare_mpc.config import MpcConfig
from avrare_mpc.nlp import build_problem, pack_parameters
from avrare_mpc.plan import from_variables, shift, start_of, to_variables
from avrare_mpc.riccati.solver import RiccatiSolver

SCENARIO = Path(__file__).parent.parent / "scenarios" / "lane_change_published.yaml"
RESULTS = Path(__file__).parent / "results" / "mpc"
SYSTEMS = {
    "casadi": ["controller.backend=casadi"],
    "riccati": ["controller.backend=riccati"],
    "ipopt": ["controller.backend=casadi", "controller.solver=ipopt"],
}
SAME, SLACK, BLOCK = 1e-3, 1e-6, 250
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Programmes:
    """M programmes: where the ego is, where the others will be, and the shifted last plan."""

    start: Floats
    other_x: Floats
    other_y: Floats
    states: Floats
    inputs: Floats


@dataclass(frozen=True)
class Answers:
    """Plans of M programmes; ``cost`` is the programme's own and infinite where there is no plan."""

    states: Floats
    inputs: Floats
    cost: Floats
    seconds: float


def collect(path: Path, rollouts: int, seed: int, settings: list[str]) -> tuple[Any, MpcConfig, Programmes]:
    """Return every programme but the first of ``rollouts`` closed loops."""
    scenario = LoadedScenario(load(path, [*settings, "controller.backend=casadi"]))
    loop, scene = scenario.stack.loop, scenario.stack.scene
    config, controller = scenario.definition.controller.config, loop.controller
    act = controller.act
    rows: list[tuple[Floats, ...]] = []

    def recorded(memory: Any, ego: Any, prediction: Any) -> Any:
        use, others = memory.solved, controller._predicted(prediction)
        start = start_of(ego, memory.plan_inputs[:, 0, 1])
        old = shift(memory.plan_states, memory.plan_inputs, scene.dt)
        parts = (start, *others, *old)
        rows.append(tuple(part[use] for part in parts))
        return act(memory, ego, prediction)

    controller.act = recorded
    noise = NoiseSource(seed, loop.noise_size)
    index = np.arange(rollouts)
    simulate(loop, (), scenario.steps, noise, Request.from_start(np.zeros_like(index), index), scored=False)
    return scene, config, Programmes(*(np.concatenate(parts) for parts in zip(*rows, strict=True)))


def by_casadi(scene: Any, config: MpcConfig, given: Programmes, solve: Callable[..., Any]) -> Answers:
    """Solve with ``solve(guess, parameters) -> (variables or None, cost)``, one after another."""
    guesses = to_variables(given.states, given.inputs)
    parameters = pack_parameters(scene, given.start, given.other_x, given.other_y)
    found, cost = np.zeros_like(guesses), np.full(len(guesses), np.inf)
    began = time.process_time()
    for m, (guess, values) in enumerate(zip(guesses, parameters, strict=True)):
        variables, least = solve(guess, values)
        if variables is not None:
            found[m], cost[m] = variables, least
    return Answers(*from_variables(found), cost, time.process_time() - began)


def converged(scene: Any, config: MpcConfig) -> Callable[..., Any]:
    """Return the reference solver: ipopt with a tolerance of 1e-9."""
    nlp = build_problem(config, scene)
    problem = {"x": nlp.variables, "p": nlp.parameters, "f": nlp.cost, "g": nlp.constraints}
    own = {"print_level": 0, "sb": "yes", "tol": 1e-9, "max_iter": 3000}
    options = {"print_time": False, "show_eval_warnings": False, "error_on_fail": False, "ipopt": own}
    solver = ca.nlpsol("reference", "ipopt", problem, options)

    def solve(guess: Floats, parameters: Floats) -> tuple[Floats | None, float]:
        found = solver(x0=guess, p=parameters, lbg=nlp.lower, ubg=nlp.upper)
        if not solver.stats()["success"]:
            return None, np.inf
        return found["x"].full().ravel(), float(found["f"])

    return solve


def by_riccati(solver: RiccatiSolver, given: Programmes) -> tuple[Answers, Any]:
    """Solve all at once; the second value has iterations and restarts."""
    rows = np.arange(len(given.start))
    began = time.process_time()
    found = solver.solve(given.start, given.other_x, given.other_y, rows, given.inputs)
    seconds = time.process_time() - began
    cost = np.where(found.found, found.cost, np.inf)
    return Answers(found.states, found.inputs, cost, seconds), found


def lost_constraints(config: MpcConfig, answers: Answers) -> int:
    """Return plans said to be found that leave a hard bound."""
    a, w = np.abs(answers.inputs).max(axis=1).T
    speed, heading = answers.states[:, 1:, 2], np.abs(answers.states[:, 1:, 3])
    out = (a > config.acceleration_max + SLACK) | (w > config.turn_rate_max + SLACK)
    out |= (speed > config.speed_max + SLACK).any(axis=1) | (speed < config.speed_min - SLACK).any(axis=1)
    out |= (heading > config.heading_max + SLACK).any(axis=1)
    if config.lateral_acceleration_max is not None:
        lateral = np.abs(answers.states[:, :-1, 2] * answers.inputs[..., 1])
        out |= (lateral > config.lateral_acceleration_max + SLACK).any(axis=1)
    return int((out & np.isfinite(answers.cost)).sum())


def row(name: str, config: MpcConfig, answers: Answers, reference: Answers) -> str:
    """Return one line of the table."""
    with np.errstate(invalid="ignore"):
        gap = answers.cost - reference.cost
        close = np.minimum(np.abs(gap), np.abs(gap / reference.cost)) < SAME
    better, failed = ~close & (gap < 0.0), ~np.isfinite(answers.cost)
    action = np.abs(answers.inputs[:, 0] - reference.inputs[:, 0])[close]
    median, high = np.quantile(action, [0.5, 0.95], axis=0)
    each = 1e6 * answers.seconds / len(gap)
    return (
        f"{name:18s} {each:9.0f} {close.mean():7.2%} {better.mean():7.2%} {(~close & ~better).mean():7.2%}"
        f" {failed.sum():6d} {lost_constraints(config, answers):5d}"
        f"   {median[0]:.0e} {high[0]:.0e}   {median[1]:.0e} {high[1]:.0e}"
    )


def agreement(path: Path, rollouts: int, seed: int, settings: list[str]) -> None:
    """Print the table, what the riccati backend spent, and where it differs most."""
    scene, config, given = collect(path, rollouts, seed, settings)
    reference = by_casadi(scene, config, given, converged(scene, config))
    own = NlpSolver(build_problem(config, scene), config.solver)

    def default(guess: Floats, parameters: Floats) -> tuple[Floats | None, float]:
        solution = own.solve(guess, parameters)
        return solution.variables, solution.cost

    casadi = by_casadi(scene, config, given, default)
    solver = RiccatiSolver(config, scene)
    by_riccati(solver, given)  # compiles, or loads what was compiled
    riccati, found = by_riccati(solver, given)
    print(f"{len(given.start)} programmes of {rollouts} rollouts of {path.stem}, seed {seed}")
    print(f"{'':18s}  us/solve    same  better   worse failed  lost   |da| 50% 95%   |dw| 50% 95%")
    for name, answers in (("ipopt 1e-9", reference), (config.solver, casadi), ("riccati", riccati)):
        print(row(name, config, answers, reference))
    quantiles = np.quantile(found.iterations, [0.5, 0.9, 0.99, 1.0]).astype(int)
    print(f"riccati: iterations mean {found.iterations.mean():.1f}, 50/90/99/100 % {quantiles}, ", end="")
    print(
        f"restarts {found.retried.mean():.3%}, {1e6 * riccati.seconds / found.iterations.sum():.2f} us each"
    )
    print("where the minimum is another one, riccati / reference - 1 and the difference in the first action:")
    ratio = riccati.cost / reference.cost - 1.0
    differs = np.flatnonzero(np.abs(ratio) >= SAME)
    change = riccati.inputs[differs, 0] - reference.inputs[differs, 0]
    print(f"  cost {_spread(ratio[differs])}\n  a {_spread(change[:, 0])}\n  w {_spread(change[:, 1])}")


def _spread(values: Floats) -> str:
    levels = (0.0, 0.1, 0.5, 0.9, 1.0)
    return "  ".join(
        f"{level:.0%} {value:+.4f}" for level, value in zip(levels, np.quantile(values, levels), strict=True)
    )


def paired(scenarios: list[Scenario], blocks: range, seed: int, results: Path) -> None:
    """Run the blocks that are missing of the scenarios, one for each system."""
    results.mkdir(parents=True, exist_ok=True)
    built: dict[str, LoadedScenario] = {}
    for block in blocks:
        for scenario in scenarios:
            file = results / block_file(scenario, seed, block)
            if not file.exists():
                own = built.setdefault(fingerprint(scenario), LoadedScenario(scenario))
                drive_block(own, seed, block, file)


def block_file(scenario: Scenario, seed: int, block: int) -> str:
    """Return the path of a block's outcome."""
    return f"{scenario.name}_{fingerprint(scenario)[:8]}_{seed}_{block:04d}.npz"


def drive_block(scenario: LoadedScenario, seed: int, block: int, file: Path) -> None:
    """Drive ``BLOCK`` rollouts of one system, into ``file``."""
    problem = scenario.problem(scenario.specifications)
    noise, index = NoiseSource(seed, problem.noise_size), np.arange(block * BLOCK, (block + 1) * BLOCK)
    began = time.process_time()
    monitors = tuple(scenario.stack.specifications.values())
    outcome = simulate(
        scenario.stack.loop,
        monitors,
        problem.steps,
        noise,
        Request.from_start(np.zeros_like(index), index),
        scored=False,
    )
    spent = time.process_time() - began
    partial = file.with_suffix(".part.npz")
    np.savez(
        partial,
        names=np.array(scenario.specifications),
        robustness=outcome.robustness,
        violated=outcome.violated,
        error=outcome.error,
        seconds=spent,
        **{f"count_{name}": values for name, values in outcome.counts.items()},
    )
    partial.rename(file)
    print(f"{file.name}: {spent:.1f} CPU s, {outcome.violated.sum(axis=0)} failures", flush=True)


def compare(systems: list[str], scenarios: list[Scenario], blocks: range, seed: int, results: Path) -> None:
    """Print failures of each rule under both systems, discordant pairs and McNemar's exact test."""
    from scipy.stats import binomtest

    pairs = []
    for block in blocks:
        files = [results / block_file(scenario, seed, block) for scenario in scenarios]
        if all(file.exists() for file in files):
            pairs.append([dict(np.load(file)) for file in files])
    if not pairs:
        print("no block is complete")
        return
    one, two = (
        {key: np.concatenate([np.atleast_1d(pair[i][key]) for pair in pairs]) for key in pairs[0][i]}
        for i in range(2)
    )
    total = len(one["error"])
    print(f"{total} rollouts of {scenarios[0].name} with the same noise, seed {seed}")
    for name, data in zip(systems, (one, two), strict=True):
        counts = {key[6:]: int(data[key].sum()) for key in data if key.startswith("count_")}
        each = 1e3 * data["seconds"].sum() / total
        print(f"{name:8s} {each:7.2f} ms a rollout, errors {data['error'].sum()}, {counts}")
    apart = (one["violated"] != two["violated"]).any(axis=1)
    print(f"verdicts differ on {apart.sum()} of them")
    columns = f"{systems[0]:>8s} {systems[1]:>8s}  only one   p (McNemar)"
    print(f"{'rule':20s} {columns}  |d robustness| 50% 90% 99%  most where verdicts differ")
    for i, name in enumerate(pairs[0][0]["names"]):
        left, right = one["violated"][:, i], two["violated"][:, i]
        only = int((left & ~right).sum()), int((right & ~left).sum())
        value = binomtest(only[0], sum(only)).pvalue if sum(only) else 1.0
        values = np.stack([one["robustness"][:, i], two["robustness"][:, i]])
        moved = np.nanquantile(np.abs(values[0] - values[1]), [0.5, 0.9, 0.99])
        most = np.abs(values[:, left != right]).max(initial=0.0)
        print(
            f"{name:20s} {left.sum():8d} {right.sum():8d}  {only[0]:3d} : {only[1]:3d}  {value:11.2g}"
            f"   {moved[0]:.1e} {moved[1]:.1e} {moved[2]:.1e}   {most:.2g}"
        )


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenario", nargs="?", type=Path, default=SCENARIO)
    parser.add_argument("--rollouts", type=int, default=60)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--paired", type=int, metavar="N", help="compare closed loops on N noise tapes")
    parser.add_argument("--pair", nargs=2, choices=SYSTEMS, default=["casadi", "riccati"])
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="as for avrare run")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--first", type=int, default=0, help="first block to run")
    parser.add_argument("--last", type=int, help="block to stop before")
    args = parser.parse_args()
    if args.paired is None:
        agreement(args.scenario, args.rollouts, args.seed, args.set)
    else:
        scenarios = [load(args.scenario, [*args.set, *SYSTEMS[name]]) for name in args.pair]
        blocks = range(-(-args.paired // BLOCK))
        paired(scenarios, blocks[args.first : args.last], args.seed, args.results)
        compare(args.pair, scenarios, blocks[args.first : args.last], args.seed, args.results)


if __name__ == "__main__":
    main()
