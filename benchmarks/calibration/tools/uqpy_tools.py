"""Adapter of UQpy: subset simulation with its modified Metropolis-Hastings sampler."""

from __future__ import annotations

import math
from importlib.metadata import version
from typing import Any

import numpy as np
from UQpy.reliability import SubsetSimulation
from UQpy.run_model import RunModel
from UQpy.sampling import ModifiedMetropolisHastings

from benchmarks.calibration.answer import Answer, Counted, NoAnswerError, of_deviation
from benchmarks.calibration.problems.problem import Floats


class Model(RunModel):  # type: ignore[misc]
    """The black box; a failure is < 0 to UQpy, so that 0 is moved below it."""

    def __init__(self, counted: Counted) -> None:
        self.counted, self.qoi_list = counted, []

    def run(self, samples: Any = None, append_samples: bool = True) -> None:
        """Evaluate the samples, and append what they gave."""
        found = self.counted.robustness(np.atleast_2d(samples))
        self.qoi_list.extend(np.where(found <= 0.0, found - 1e-12, found).tolist())


def tool_version() -> str:
    """Return the version of UQpy."""
    return version("UQpy")


def estimate(method: str, counted: Counted, budget: int, seed: int, options: dict[str, Any]) -> Answer:
    """Return its estimate; first samples are independent, as its documentation advises."""
    d, size = counted.problem.dimension, max(budget // 50, 2) * 10
    generator = np.random.RandomState(seed)
    first = generator.standard_normal((size, d))
    sampler = ModifiedMetropolisHastings(
        log_pdf_target=[_log_density] * d, dimension=d, seed=first[: size // 10].tolist(),
        random_state=generator,
    )  # fmt: skip
    try:
        found = SubsetSimulation(
            runmodel_object=Model(counted), sampling=sampler, samples_init=first, nsamples_per_subset=size
        )
    except NoAnswerError:
        raise
    except Exception as error:
        raise NoAnswerError(" ".join(str(error).split())[:200]) from error
    return of_deviation(float(found.failure_probability), float(found.dependent_chains_CoV))


def _log_density(x: Floats) -> Floats:
    density: Floats = -0.5 * np.asarray(x).reshape(len(x), -1)[:, 0] ** 2 - 0.5 * math.log(2.0 * math.pi)
    return density
