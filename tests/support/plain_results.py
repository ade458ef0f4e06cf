"""A result with given fields, without an estimate."""

import dataclasses

import numpy as np

from avrare.estimation.result.result import Failures, Result, Worst


def plain_result(
    specification="left", failures=0, tapes=None, robustness=None, interval=(0.0, 1.0), **fields
):
    tapes = np.zeros((0, 1, 0)) if tapes is None else tapes
    robustness = np.zeros(len(tapes)) if robustness is None else np.asarray(robustness)
    result = Result(
        specification,
        estimator="mc",
        probability=0.1,
        interval_at=lambda confidence: interval,
        confidence=0.95,
        run_probabilities=np.zeros(0),
        relative_error=0.1,
        rollouts=4,
        simulated_steps=4,
        errors=0,
        health={},
        failures=Failures(tapes, robustness, failures),
        worst=Worst(np.zeros((1, 0)), np.nan),
        robustness=np.zeros(0),
    )
    return dataclasses.replace(result, **fields)
