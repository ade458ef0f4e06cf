"""Reference problems by id, and generators of more of them.

Each family tests another ability of an estimator: several failure regions (``conjunction``, ``four_branch``),
many dimensions (``linear``), progress that lasts (``walk``) or decays (``ornstein_uhlenbeck``),
ties at every level (``count_down``, ``plus_minus``), a robustness that recovers (``reach``, ``response``),
and non-Gaussian noise (``exponential_sum``, ``lognormal_product``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache

from avrare.base.errors import UsageError, did_you_mean
from avrare.testing.reference_problem import ReferenceProblem
from avrare.testing.static_problems import (
    conjunction,
    exponential_sum,
    four_branch,
    linear,
    lognormal_product,
)
from avrare.testing.walk_problems import count_down, ornstein_uhlenbeck, plus_minus, reach, response, walk

__all__ = [
    "ReferenceProblem", "conjunction", "count_down", "exponential_sum", "families", "four_branch", "linear",
    "lognormal_product", "ornstein_uhlenbeck", "plus_minus", "reach", "reference_problem",
    "reference_problems", "response", "walk",
]  # fmt: skip


def families() -> Mapping[str, Callable[..., ReferenceProblem]]:
    """Return the generators by name: ``families()["walk"](level=2.0, steps=50)``."""
    return {
        generator.__name__: generator
        for generator in (
            conjunction,
            linear,
            four_branch,
            walk,
            ornstein_uhlenbeck,
            count_down,
            plus_minus,
            reach,
            response,
            exponential_sum,
            lognormal_product,
        )
    }


@lru_cache(maxsize=1)
def reference_problems() -> tuple[ReferenceProblem, ...]:
    """Return all reference problems, with their probabilities to nine digits or more."""
    return tuple(replace(problem, id=name, published=p) for name, p, problem in _table())


def reference_problem(id: str) -> ReferenceProblem:
    """Return the reference problem of this id.

    Raises:
        UsageError: There is none.
    """
    problems = {problem.id: problem for problem in reference_problems()}
    if id not in problems:
        raise UsageError(f"unknown reference problem {id!r}", did_you_mean(id, problems))
    return problems[id]


def _table() -> tuple[tuple[str, float, ReferenceProblem], ...]:
    return (
        ("a_beta_-2", 0.0010351370073191286, conjunction(-2.0)),
        ("a_beta_-2.5", 7.711988691629287e-05, conjunction(-2.5)),
        ("a_beta_-3", 3.6444493915976075e-06, conjunction(-3.0)),
        ("b_linear_d100_p1e-4", 1e-4, linear(3.7190164854556804)),
        ("b_linear_d100_p1e-6", 1e-6, linear(4.753424308822899)),
        ("b_linear_d100_p1e-9", 1e-9, linear(5.9978070150076865)),
        ("c_fourbranch_k6", 0.004457331490626491, four_branch(6.0)),
        ("c_fourbranch_k7", 0.0022227950661944398, four_branch(7.0)),
        ("d_rw_L2.5", 0.010618888379036615, walk(2.5)),
        ("d_rw_L3.8", 0.00011654634848510524, walk(3.8)),
        ("d_rw_L4.8", 1.2225926292977209e-06, walk(4.8)),
        ("d_rw_L5.9", 2.67398695113006e-09, walk(5.9)),
        ("e_ou_L3.0", 0.0527543321826538, ornstein_uhlenbeck(3.0)),
        ("e_ou_L4.0", 0.0016780051045810328, ornstein_uhlenbeck(4.0)),
        ("e_ou_L5.0", 1.7964133614711844e-05, ornstein_uhlenbeck(5.0)),
        ("e_ou_L6.0", 6.832111019270873e-08, ornstein_uhlenbeck(6.0)),
        ("f1_count_T40_q1o10_m12", 0.00038083426673634236, count_down(12, 40, "1/10")),
        ("f1_count_T40_q1o10_m15", 3.48055026700092e-06, count_down(15, 40, "1/10")),
        ("f1_count_T9_q1o5_m9", 5.12e-07, count_down(9, 9, "1/5")),
        ("f1_count_T20_q1o100_m4", 4.262092764244013e-05, count_down(4, 20, "1/100")),
        ("f1_count_T20_q1o100_m5", 1.367798632893411e-06, count_down(5, 20, "1/100")),
        ("f2_pm1walk_T60_q2o5_m14", 0.0017660093154436658, plus_minus(14, 60, "2/5")),
        ("f2_pm1walk_T60_q2o5_m18", 0.00020081264931448548, plus_minus(18, 60, "2/5")),
        ("f2_pm1walk_T100_q3o10_m14", 7.043225835557945e-06, plus_minus(14, 100, "3/10")),
        ("g_eventually_c0.5", 0.0008442924721224347, reach(0.5)),
        ("g_eventually_c0.25", 0.00028731303291469786, reach(0.25)),
        ("g_eventually_c1.0", 0.004218415467302355, reach(1.0)),
        ("h_response_k20", 0.14703813978231897, response(20)),
        ("h_response_k30", 0.05758970611145886, response(30)),
        ("h_response_k40", 0.021681537367058048, response(40)),
        ("i_exp_sum_d10_c30.0", 7.121750862815577e-06, exponential_sum(30.0)),
        ("i_exp_sum_d10_c40.0", 3.925932226286188e-09, exponential_sum(40.0)),
        ("i_lognormal_prod_d1", 0.00010000000000000006, lognormal_product(6.420578628740803, 1)),
        ("i_lognormal_prod_d5", 1.0000000000000012e-06, lognormal_product(203.2608115180556)),
        ("h_response_k60", 0.0028189748841235237, response(60)),
        ("h_response_k80", 0.00029192986568563046, response(80)),
    )
