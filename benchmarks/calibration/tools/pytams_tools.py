"""Adapter of pyTAMS: a step system as its forward model, ten runs for an interval."""

from __future__ import annotations

import concurrent.futures
import gc
import os
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from pytams import taskrunner
from pytams.fmodel import ForwardModelBaseClass
from pytams.tams import TAMS

from benchmarks.calibration.answer import Answer, Counted, NoAnswerError, of_runs

RUNS = 10
_INPUT = """
[tams]
ntrajectories = {particles}
nsplititer = 1000000
loglevel = "ERROR"
[runner]
type = "asyncio"
[trajectory]
end_time = {steps}.0
step_size = 1.0
targetscore = 1.0
"""


class _Executor(concurrent.futures.ThreadPoolExecutor):
    """Its worker in this process: the black box counts here, and no model is pickled."""


taskrunner.concurrent.futures.ProcessPoolExecutor = _Executor  # type: ignore[misc]


def tool_version() -> str:
    """Return the version of pyTAMS."""
    return version("pytams")


def estimate(method: str, counted: Counted, budget: int, seed: int, options: dict[str, Any]) -> Answer:
    """Return the mean of ten runs; N = budget / 60 trajectories a run, of which one is discarded a level."""
    np.random.seed(seed)
    generator = np.random.default_rng(seed)
    # Its own choice of parents is drawn from a fresh generator; this seeds it.
    fresh = np.random.default_rng
    np.random.default_rng = lambda seed=None: fresh(generator.integers(2**63) if seed is None else seed)  # type: ignore[assignment]
    try:
        model = _model(counted, generator)
        return of_runs([_run(model, counted, max(budget // 60, 10)) for _ in range(RUNS)])
    finally:
        np.random.default_rng = fresh


def _run(model: type, counted: Counted, particles: int) -> float:
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)  # its database is a file of the working directory
        try:
            text = _INPUT.format(particles=particles, steps=counted.problem.system.steps)
            Path("input.toml").write_text(text, encoding="utf-8")
            return float(TAMS(fmodel_t=model, a_args=["-i", "input.toml"]).compute_probability())
        except RuntimeError as error:
            reason = str(error)
        finally:
            gc.collect()  # a database removes its file as it goes: now, or the next run's of the same name
            os.chdir(here)
    raise NoAnswerError(reason)


def _model(counted: Counted, generator: np.random.Generator) -> type:
    system = counted.problem.system

    class Model(ForwardModelBaseClass):  # type: ignore[misc]
        """The step system, one trajectory at a time."""

        def _init_model(self, m_id: int, params: dict[Any, Any]) -> None:
            self.state = np.array([system.start], dtype=float)

        def _advance(self, step: int, time: float, dt: float, noise: Any, need_end_state: bool) -> float:
            self.state = counted.step(self.state, noise)
            return dt

        def get_current_state(self) -> Any:
            return self.state

        def set_current_state(self, state: Any) -> None:
            self.state = state

        def score(self) -> float:
            return float(system.score(self.state)[0])

        def make_noise(self) -> Any:
            return generator.standard_normal((1, system.noise_size))

    return Model
