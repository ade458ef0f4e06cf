"""A plugin for the tests: an estimator that checks others, that ``auto`` may choose, and that warns."""

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from pydantic import Field

from avrare.base.chart import Chart, make_linear_scale
from avrare.base.health_messages import fill
from avrare.estimation.checks.result_builder import build_result
from avrare.estimation.plan.plan import Estimator, Info, Plan
from avrare.estimation.result.charts import draw_histogram
from avrare.estimation.result.intervals import log_normal, unknown
from avrare.estimation.result.note import Note
from avrare.estimation.result.result import Failures, Worst
from avrare.plugin import AutoRole, CheckRole, Component, Options, hookimpl
from avrare.rollout.request import Request, Rollouts

WARNINGS = {"widened_noise": "the noise is {scale:g} times as wide as it is meant to be"}


class WidenedConfig(Options):
    rollouts: int = Field(1000, ge=2, description="rollouts")
    scale: float = Field(1.5, gt=1.0, description="standard deviation of the noise")


@dataclass(frozen=True)
class State:
    plan: Plan
    tapes: np.ndarray
    info: Info
    outcome: Rollouts | None = None


class Widened(Estimator):
    """Importance sampling from noise that is wider than standard normal."""

    name = "widened"
    single = True

    def __init__(self, config):
        self.config = config

    def scale(self, rollouts, probability):
        return Widened(self.config.model_copy(update={"rollouts": max(2, int(rollouts))}))

    def init(self, plan):
        rollouts, budget = self.config.rollouts, plan.budget
        if budget is not None:
            rollouts = int(budget.amount / (plan.steps if budget.kind == "steps" else 1))
        normals = plan.noise.normals(0, 0, np.arange(rollouts)[:, None], np.arange(plan.steps + 1))
        state = State(plan, self.config.scale * normals, Info(goal=rollouts))
        return state, state.info

    def ask(self, state):
        return Request.replay(state.tapes) if state.outcome is None else None

    def tell(self, state, rollouts):
        info = state.info.plus(rollouts)
        return replace(state, info=info, outcome=rollouts), info

    def estimate(self, state):
        scale, outcome, tapes = self.config.scale, state.outcome, state.tapes
        exponents = (scale**-2 - 1.0) * (tapes**2).sum(axis=(1, 2)) / 2.0
        weights = scale ** tapes[0].size * np.exp(exponents) * outcome.violated[:, 0]
        mean, rows, robustness = weights.mean(), np.flatnonzero(weights), outcome.robustness[:, 0]
        error = weights.std() / math.sqrt(len(weights))
        relative = error / mean if mean else math.nan
        interval = partial(log_normal, mean, relative**2, freedom=len(rows) - 1) if len(rows) > 1 else unknown
        worst = robustness.argmin()
        return [
            build_result(
                state.plan, self.name, state.info, np.array([mean]),
                interval_at=interval,
                relative_error=relative,
                health=fill(WARNINGS, "widened_noise", scale=scale),
                failures=Failures(tapes[rows], robustness[rows], len(rows)),
                worst=Worst(tapes[worst], robustness[worst]),
                robustness=robustness,
                notes=(Note("widening", f"The noise is {scale:g} times as wide as it is meant to be."),),
                diagnostics={"weights": np.sort(weights[rows]).tolist()},
            )
        ]  # fmt: skip


def build(config, scene):
    return Widened(config)


def draw_charts(result):
    weights = np.array(result.diagnostics["weights"])
    order = np.arange(len(weights))
    chart = Chart(make_linear_scale(order), make_linear_scale(weights, zero=True), "Sorted weights")
    return *draw_histogram(result), chart.dots(order, weights)


@hookimpl
def avrare_components():
    return [
        Component(
            kind="estimator",
            name="widened",
            config="avrare_widened:WidenedConfig",
            factory="avrare_widened:build",
            summary="importance sampling from wider noise",
            warnings=WARNINGS,
            cross_check=CheckRole(order=50),
            auto=AutoRole(order=50),
            charts="avrare_widened:draw_charts",
        )
    ]
