"""Monte Carlo of a choice answered by a truth: its rollouts are drawn again, and nothing is simulated."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import ndtr

import avrare
from avrare import Problem, stl
from avrare.estimation.choice.auto import Auto
from avrare.estimation.choice.auto_config import AutoConfig
from avrare.estimation.loop.loop import run
from avrare.estimation.plan.plan import Estimator, Execute
from avrare.estimation.plan.settings import Settings
from avrare.estimation.result.result import Result
from avrare.protocols import Floats
from avrare.rollout.executors.work import build_executor


class DrawnAgain:
    """System each of whose rollouts is one of a truth's, drawn with replacement: failing or not.

    Args:
        probability: Share of the truth's rollouts that fail.
    """

    noise_size = 1

    def __init__(self, probability: float) -> None:
        self.probability = probability

    def initial(self, noise: Floats) -> Floats:
        """Draw: -1 where the rollout fails, else 1."""
        return np.where(ndtr(noise[:, 0]) < self.probability, -1.0, 1.0)

    def step(self, state: Floats, noise: Floats) -> Floats:
        """Go on as drawn."""
        return state

    def signals(self, state: Floats) -> dict[str, Floats]:
        """Return ``x``, negative where the rollout fails."""
        return {"x": state}


class AnsweredAuto:
    """``auto`` whose pilot and Monte Carlo are answered by a truth; all that learns or branches is simulated.

    Args:
        auto: The choice.
        probability: Share of the truth's rollouts that fail.
    """

    name = "auto"

    def __init__(self, auto: Auto, probability: float) -> None:
        self.auto = auto
        self.probability = probability

    def estimate_by(self, problem: Problem, settings: Settings, execute: Execute) -> list[Result]:
        """Return one result, as the choice does."""
        (name,) = problem.names
        answers = Problem(DrawnAgain(self.probability), {name: stl("always (x > 0)")}, problem.steps)

        def answered(part: Problem, estimator: Estimator, settings: Settings, label: str) -> list[Result]:
            return execute(answers if estimator.name == "mc" else part, estimator, settings, label)

        return self.auto.estimate_by(problem, settings, answered)


def estimate(problem: Problem, probability: float, seed: int, **options: Any) -> avrare.Result:
    """Return what ``auto`` finds on a problem with one specification, of known probability."""
    answered: Any = AnsweredAuto(Auto(AutoConfig(**options)), probability)
    return run(problem, answered, build_executor(1), Settings(seed))[0]
