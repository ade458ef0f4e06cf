"""Is the riccati backend of the controller `mpc` the controller that the casadi backend is, and how fast?

    OMP_NUM_THREADS=1 python benchmarks/mpc.py [SCENARIO] [--rollouts 60] [--set KEY=VALUE ...]

Drives lane changes with the casadi backend and solves every programme of every later step again from the same
warm start: by ipopt to a tolerance of 1e-9 (the reference), by the casadi backend's solver, and by the
riccati backend. "Same" is a cost within 1e-3 of the reference, absolutely or relatively; "better" is lower;
"lost" is a plan that is said to be found and leaves a hard bound.
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
from avrare.scenario.load import load
from avrare_mpc.casadi_search import NlpSolver
from avrare_mpc.config import MpcConfig
from avrare_mpc.nlp import build_problem, pack_parameters
from avrare_mpc.plan import from_variables, shift, start_of, to_variables
from avrare_mpc.riccati.solver import RiccatiSolver

SCENARIO = Path(__file__).parent.parent / "scenarios" / "lane_change_published.yaml"
SAME, SLACK = 1e-3, 1e-6
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
        use, others = memory.solved, controller._list_predictions(prediction)
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
    plans = solver.solve(given.start, given.other_x, given.other_y, rows, given.inputs)
    seconds = time.process_time() - began
    cost = np.where(plans.feasible, plans.cost, np.inf)
    return Answers(plans.states, plans.inputs, cost, seconds), plans


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


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenario", nargs="?", type=Path, default=SCENARIO)
    parser.add_argument("--rollouts", type=int, default=60)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="as for avrare run")
    args = parser.parse_args()
    agreement(args.scenario, args.rollouts, args.seed, args.set)


if __name__ == "__main__":
    main()
