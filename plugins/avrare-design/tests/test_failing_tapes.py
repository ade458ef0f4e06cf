"""Derivatives from failing tapes against exact ones, and against the exact slices of a linear system."""

import math

import numpy as np
import pytest

from avrare.analysis.causes.failure_sample import FailureSample
from avrare.analysis.causes.tape_runs import TapeRunner
from avrare.estimation.result.result import Failures
from avrare_design.failing_tapes import derive_from_failures
from avrare_design.sensitivity import sample_failures
from noisy_loop import exact, noisy_problem


def derived(rollouts, step=0.05, seed=1, turned=1.0):
    sample = sample_failures(noisy_problem(), rollouts, seed, 0.95, TapeRunner())
    ends = tuple(noisy_problem(gain=1.0 + turned * end * step) for end in (-1.0, 1.0))
    return derive_from_failures(ends, step, sample, TapeRunner(), "gain"), sample


def exact_derivative():
    return (math.log(exact(1.001).p) - math.log(exact(0.999).p)) / 0.002


def test_failing_tapes_give_the_derivative():
    found, sample = derived(40_000)
    truth = exact_derivative()
    assert abs(found.value - truth) < 3.5 * found.error
    assert found.error < 0.2 * truth, (found, sample.size)
    assert found.kept[0] < found.kept[1]
    assert found.shrunk == pytest.approx(found.value, rel=0.1)


def test_errors_are_those_of_repetitions():
    many = [derived(3000, seed=seed)[0] for seed in range(40)]
    scatter = np.std([one.value for one in many], ddof=1)
    assert scatter == pytest.approx(np.mean([one.error for one in many]), rel=0.4)
    mean = np.mean([one.value for one in many])
    assert abs(mean - exact_derivative()) < 4.0 * scatter / math.sqrt(40)


def test_what_changes_nothing_has_no_derivative():
    sample = sample_failures(noisy_problem(), 2000, 1, 0.95, TapeRunner())
    same = noisy_problem()
    found = derive_from_failures((same, same), 0.1, sample, TapeRunner(), "nothing")
    assert (found.value, found.shrunk) == (0.0, 0.0)
    assert found.error > 0.0


def test_one_failure_says_nothing():
    tape = sample_failures(noisy_problem(), 2000, 1, 0.95, TapeRunner()).failures.noise[:1]
    sample = FailureSample(Failures(tape, np.zeros(1), 1), 0.01, 1.0, 100, 1, 0, 0.95)
    ends = noisy_problem(gain=0.5), noisy_problem(gain=1.5)
    found = derive_from_failures(ends, 0.5, sample, TapeRunner(), "gain")
    assert (found.error, found.shrunk) == (math.inf, 0.0)
