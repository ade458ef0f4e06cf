"""Rollouts selected for a report."""

import numpy as np

import avrare
from avrare.analysis.monitor.monitoring import monitor_recording
from avrare.analysis.page import player
from avrare.analysis.page.stored_rollouts import select_rollouts
from avrare.estimation.result.result import Worst
from avrare.results.recordings import Recording
from avrare.results.stored_causes import StoredKinds
from plain_results import plain_result


def test_the_most_likely_failure_has_the_shortest_noise():
    noise = np.zeros((3, 4, 2))
    noise[:, 0, 0] = [3.0, 1.0, 2.0]
    found = select_rollouts(plain_result(tapes=noise, robustness=[-1.0, -0.1, -5.0]))
    assert [(one.title, one.robustness, one.norm) for one in found] == [
        ("Worst failure", -5.0, 2.0),
        ("Failure with the smallest noise", -0.1, 1.0),
    ]
    one = select_rollouts(plain_result(tapes=noise[:1], robustness=[-1.0]))
    assert [shown.title for shown in one] == ["Worst failure, and the one with the smallest noise"]
    near = select_rollouts(plain_result(worst=Worst(noise[0], 0.5)))
    assert [(shown.title, shown.failed) for shown in near] == [("Nearest to a failure", False)]
    assert select_rollouts(plain_result()) == []


def test_a_player_opens_three_seconds_before_the_failure():
    signals = {"x": np.where(np.arange(100) < 60, 1.0, -1.0)}
    recording = Recording("t", 0.1, 0.0, signals)
    result = monitor_recording("x", avrare.stl("always (x > 0)", dt=0.1).monitor(), recording)
    assert player._select_start(result) == 30
    early = monitor_recording("x", avrare.stl("always (x < 0)", dt=0.1).monitor(), recording)
    assert player._select_start(early) == 0


def test_each_kind_has_its_most_typical_failure():
    noise = np.zeros((3, 4, 2))
    result = plain_result(tapes=noise, robustness=[-1.0, -0.1, -5.0])
    common = {"probability": 0.1, "low": 0.05, "high": 0.2, "share": 0.5, "text": "x", "warnings": []}
    kinds = StoredKinds.model_validate(
        {
            "probability": 0.2,
            "kinds": [{"kind": k + 1, "representative": r, **common} for k, r in enumerate((2, 1))],
        }
    )
    found = select_rollouts(result, kinds)
    assert [(one.title, one.index, one.kind) for one in found] == [
        ("Most typical failure of kind 1, and the worst", 2, 1),
        ("Most typical failure of kind 2", 1, 2),
    ]


def test_hyphens_in_names_are_not_minus_signs():
    assert player.typeset_minus("a-b cut-in -0.5 (-3) x-1 1e-5") == "a-b cut-in −0.5 (−3) x-1 1e-5"
