"""Every check notices what it is for, and says so in one line; what importing each description costs."""

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import lanelet_scenes
from avrare.base.errors import PluginError, UsageError
from avrare.cli import plugins
from avrare.cli.main import main
from avrare.plugin.component import KINDS, Component
from avrare.plugin.registry import Registry, Row, default_registry
from avrare.testing.conformance import Check, Subject, checks_of, examine
from avrare.testing.conformance.closed_loop_part_checks import Exercise

HERE = Path(__file__).parent
MONTE_CARLO = "avrare.estimation.monte_carlo"

WRONG = {
    "description_is_light": ("simulator", {"config": "heavy:Weighted"}),
    "summary_is_one_line": ("simulator", {"summary": "one\ntwo"}),
    "config_is_strict": ("simulator", {"config": "wrong:Loose"}),
    "options_are_described": ("simulator", {"config": "wrong:Silent"}),
    "options_pickle": ("simulator", {"config": "wrong:Hidden"}),
    "factory_builds": ("simulator", {"factory": "wrong:stepless"}),
    "outputs_are_rows": ("simulator", {"factory": "wrong:listing"}),
    "same_noise_same_bits": ("simulator", {"factory": "wrong:remembering"}),
    "draws_no_numbers_of_its_own": ("simulator", {"factory": "wrong:rolling"}),
    "rows_are_independent": ("simulator", {"factory": "wrong:sociable"}),
    "states_can_be_copied": ("simulator", {"factory": "wrong:opaque"}),
    "states_are_values": ("simulator", {"factory": "wrong:writing"}),
    "nan_stays_in_its_row": ("simulator", {"factory": "wrong:fussy"}),
    "unbiased_on_a_walk": ("estimator", {"factory": "wrong:half"}),
    "unbiased_with_ties": ("estimator", {"factory": "wrong:half"}),
    "interval_covers": ("estimator", {"factory": "wrong:overconfident"}),
    "impossible_is_zero": ("estimator", {"factory": "wrong:pessimist"}),
    "certain_is_one": ("estimator", {"factory": "wrong:half"}),
    "errors_are_no_failures": ("estimator", {"factory": "wrong:forgiving"}),
    "cost_is_honest": ("estimator", {"factory": "wrong:cheap"}),
    "budget_is_kept": ("estimator", {"factory": "wrong:spender"}),
    "same_seed_same_bits": ("estimator", {"factory": "wrong:chunky"}),
    "runs_are_a_prefix": ("estimator", {"factory": "wrong:shuffling"}),
    "failures_replay": ("estimator", {"factory": "wrong:forging"}),
    "results_are_consistent": ("estimator", {"factory": "wrong:rounding"}),
    "charts_are_drawn": ("estimator", {"charts": "wrong:draw_words"}),
    "unknown_options_are_refused": ("estimator", {"config": "wrong:Lenient"}),
    "outcomes_are_those_of_serial": ("executor", {"factory": "wrong:backwards"}),
    "runs_functions_on_workers": ("executor", {"factory": "wrong:idle"}),
    "runs_more_than_once": ("executor", {"factory": "wrong:once"}),
    "takes_chunks_as_there_is_room": ("executor", {"factory": "wrong:greedy"}),
    "errors_come_through": ("executor", {"factory": "wrong:deaf"}),
}
"""Check -> (kind, what is changed in a component that passes)."""

GOOD = {
    "simulator": ("wrong:Weighted", "wrong:good"),
    "estimator": (f"{MONTE_CARLO}.config:McConfig", f"{MONTE_CARLO}.monte_carlo:build"),
    "executor": ("avrare.rollout.executors.work:ExecutorConfig", "avrare.rollout.executors.serial:build"),
}


@pytest.fixture(autouse=True)
def _path(monkeypatch):
    monkeypatch.syspath_prepend(str(HERE))


def subject(kind, **changes):
    config, factory = GOOD[kind]
    given = {"config": config, "factory": factory, "summary": "for tests", **changes}
    part = Component(kind=kind, name="tested", **given)
    return Subject(Row(kind, "tested", "avrare-tested", "1.0", "ok", component=part))


def registered(kind, monkeypatch, **changes):
    """Register the subject under a name that ``avrare.estimate`` finds."""
    one = subject(kind, **changes)

    class Plugin:
        from avrare.plugin import hookimpl

        @hookimpl
        def avrare_components(self):
            return [one.component]

    registry = Registry()
    registry.register(Plugin(), "tested", "avrare-tested", "1.0")
    monkeypatch.setattr(Registry, "discover", classmethod(lambda cls: registry))
    default_registry.cache_clear()
    return one


@pytest.fixture(autouse=True)
def forgotten(monkeypatch):
    yield
    default_registry.cache_clear()


def test_every_check_is_tested():
    names = {check.name for kind in KINDS for check in checks_of(kind)}
    assert names == set(WRONG)


@pytest.mark.slow
@pytest.mark.parametrize("name", WRONG)
def test_faulty_parts_fail_their_check(name, monkeypatch):
    kind, changes = WRONG[name]
    (check,) = (check for check in checks_of(kind) if check.name == name)
    right = check.run(registered(kind, monkeypatch))
    assert (right.status, right.reason) == ("passed", "")
    wrong = check.run(registered(kind, monkeypatch, **changes))
    assert wrong.status == "failed", wrong
    assert wrong.reason
    assert "\n" not in wrong.reason


def test_a_missing_unit_is_reported():
    outcomes = {one.check: one for one in examine(subject("simulator", config="wrong:Unitless"))}
    reason = outcomes["options_are_described"].reason
    assert reason.startswith("no unit in brackets: Unitless.top_speed")  # pytest adds the assertion


def test_parts_that_cannot_be_built_are_skipped_with_a_reason():
    outcomes = list(examine(subject("simulator", config="wrong:Insatiable")))
    assert {one.status for one in outcomes} == {"passed", "skipped"}
    (reason,) = {one.reason for one in outcomes if one.status == "skipped"}
    assert reason == "no defaults for weight: give --set, or the model an example"


@pytest.mark.parametrize("factory", ["steered", "asking"])
def test_a_simulator_that_needs_an_action_does_not_fail(factory):
    outcomes = list(examine(subject("simulator", factory=f"wrong:{factory}")))
    assert {one.status for one in outcomes} == {"passed", "skipped"}
    (reason,) = {one.reason for one in outcomes if one.status == "skipped"}
    assert reason.startswith("it needs an action, which only its own controller knows: ")


@pytest.mark.parametrize(
    ("factory", "reason"),
    [
        ("mistyped", "TypeError: can only add numbers"),
        ("windless", "AttributeError: 'NoneType' object has no attribute 'x'"),
    ],
)
def test_an_error_of_the_simulator_is_not_a_need_for_an_action(factory, reason):
    outcomes = list(examine(subject("simulator", factory=f"wrong:{factory}")))
    assert {one.reason for one in outcomes if one.status == "failed"} == {reason}


PARTS = [row for row in default_registry().rows() if row.component]
PARTS = [row for row in PARTS if row.kind not in ("estimator", "executor") and row.name != "mpc"]  # too slow


@pytest.mark.slow
@pytest.mark.parametrize("row", PARTS, ids=lambda row: f"{row.kind}-{row.name}")
def test_the_conformance_of_every_installed_part(row, tmp_path):
    options = {}
    if row.name == "commonroad":  # it replays a file, and there is none to be its default
        options["file"] = tmp_path / "bend.xml"
        options["file"].write_text(lanelet_scenes.KINDS["bend"](0.0), encoding="utf-8")
    if row.name == "openscenario":  # nor is there one here
        options["file"] = Path(__file__).parents[3] / "scenarios/openscenario/cut_in.xosc"
    assert [one.reason for one in examine(Subject(row, options)) if one.status == "failed"] == []


def test_the_rows_of_an_exercise_are_the_rows_of_a_batch():
    exercise = Exercise(Subject.find_installed("tracker", "imm"))
    for row in range(exercise.rows):
        alone = exercise.play(exercise.tape[[row]])
        for name, value in exercise.outputs.items():
            assert alone[name].tobytes() == value[[row]].tobytes(), name


def lasting(**changes):
    given = {"config": "wrong:Weighted", "factory": "wrong:lasting", "summary": "for tests", **changes}
    part = Component(kind="perception", name="tested", **given)
    return Subject(Row("perception", "tested", "avrare-tested", "1.0", "ok", component=part))


def test_the_memory_of_persistent_errors_is_exercised():
    exercise = Exercise(lasting())
    assert any(name.startswith("followed x") for name in exercise.outputs)
    assert {one.status for one in examine(lasting())} == {"passed"}


@pytest.mark.parametrize(
    ("factory", "failed"),
    [
        ("forgetful", {"same_noise_same_bits", "rows_are_independent"}),
        ("smearing", {"rows_are_independent"}),
        ("scribbling", {"states_are_values"}),
    ],
)
def test_faulty_persistent_errors_are_detected(factory, failed):
    found = examine(lasting(factory=f"wrong:{factory}"))
    assert failed <= {one.check for one in found if one.status == "failed"}


def test_unknown_kinds_are_refused():
    with pytest.raises(UsageError, match="unknown kind 'wheel'"):
        checks_of("wheel")


def test_a_check_is_any_function():
    def never(subject):
        raise SystemExit(3)

    outcome = Check(never).run(subject("simulator"))
    assert (outcome.status, outcome.reason) == ("failed", "SystemExit: 3")


def test_the_command(capsys):
    assert main(["plugins", "--check", "serial"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("executor serial (avrare ")
    assert lines[-1] == "11 passed, 0 failed, 0 skipped"
    assert "description_is_light" in lines[1]
    assert "imports nothing heavy" in lines[1]


def test_a_failed_check_is_exit_1(capsys, monkeypatch):
    one = subject("simulator", factory="wrong:sociable")
    monkeypatch.setattr("avrare.cli.plugin_checks.subjects", lambda *arguments: [one])
    assert main(["plugins", "--check", "tested"]) == 1
    out = capsys.readouterr().out
    assert "  failed  rows_are_independent" in out
    assert "differs rows [2] without the others" in out


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (["nothing"], 5, "no component or distribution 'nothing' is installed"),
        (["imm", "--set", "banana=1"], 4, "unknown option 'banana' of tracker 'imm'"),
        (["imm", "--set", "banana"], 4, "should be KEY=VALUE"),
        (["imm", "--kind", "simulator"], 4, "'imm' has no component of kind 'simulator'"),
        (["imm", "--kind", "wheel"], 4, "unknown kind 'wheel'"),
        (["avrare", "--set", "workers=2"], 4, "components, and options can be set for only one"),
    ],
)
def test_mistakes_are_one_clear_line(words, code, text, capsys):
    assert main(["plugins", "--check", *words]) == code
    assert text in capsys.readouterr().err


def test_a_plugin_that_does_not_load_is_exit_5(capsys, monkeypatch):
    registry = Registry()
    registry.register(sys, "tested", "avrare-tested", "1.0")
    monkeypatch.setattr("avrare.cli.plugin_checks.default_registry", lambda: registry)
    assert main(["plugins", "--check", "avrare-tested"]) == PluginError.exit_code
    assert "it has no hook avrare_components" in capsys.readouterr().err


def rows(capsys, *words):
    assert main(["plugins", "--json", *words]) == 0
    return json.loads(capsys.readouterr().out)


def test_times_are_shown_on_demand(capsys):
    timed = rows(capsys, "--timing")
    assert all(row["import_seconds"] is not None for row in timed if row["distribution"] == "avrare-imm")
    assert {row["import_seconds"] for row in timed if row["distribution"] == "avrare"} == {None}
    plain = [{key: row[key] for key in row if key != "import_seconds"} for row in timed]
    assert plain == rows(capsys)


def test_a_slow_import_is_the_one_that_is_shown(monkeypatch):
    clock = iter([0.0, 0.25, 1.0, 1.5])
    monkeypatch.setattr(plugins.time, "perf_counter", lambda: next(clock))
    monkeypatch.setattr(plugins, "entry_points", lambda group: [point("slow"), point("slower")])
    monkeypatch.delenv("AVRARE_PLUGINS", raising=False)
    assert plugins._import_seconds() == {"avrare-slow": 0.25, "avrare-slower": 0.5}


def point(name):
    return SimpleNamespace(name=name, dist=SimpleNamespace(name=f"avrare-{name}"), load=lambda: None)
