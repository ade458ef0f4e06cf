"""Pytest plugin: scenario files as tests, and estimates as a fixture.

Every pytest run loads it if avrare is installed, so it imports only pytest until a scenario is collected or
an estimate is requested.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from _pytest._code.code import TerminalRepr, TracebackStyle

    from avrare.analysis.check.gate import CheckResult
    from avrare.analysis.check.targets import CheckTarget
    from avrare.estimation.result.result import Result

_MARK = "avrare(scenario, specification, set=(), budget=None, workers=1): what `avrare_result` estimates"

_SCENARIOS = pytest.StashKey[set[Path]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the plugin's settings."""
    text = "scenario files to collect as tests: globs, relative to the root folder"
    parser.addini("avrare_scenarios", text, type="linelist", default=[])
    text = "outcome of a test with an inconclusive verdict: fail or skip"
    parser.addini("avrare_inconclusive", text, default="fail")


def pytest_configure(config: pytest.Config) -> None:
    """Register the mark and find the scenario files."""
    config.addinivalue_line("markers", _MARK)
    globs = config.getini("avrare_scenarios")
    config.stash[_SCENARIOS] = {path for glob in globs for path in _matching(config, glob)}


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> ScenarioFile | None:
    """Collect the file if it is one of ``avrare_scenarios``."""
    scenarios = parent.config.stash[_SCENARIOS]
    return ScenarioFile.from_parent(parent, path=file_path) if file_path in scenarios else None


def _matching(config: pytest.Config, glob: str) -> list[Path]:
    try:
        paths = list(config.rootpath.glob(glob))
    except (NotImplementedError, ValueError) as error:
        text = f"avrare_scenarios: {glob!r} should be a glob relative to {config.rootpath}: {error}"
        raise pytest.UsageError(text) from None
    if not paths:
        text = f"avrare_scenarios: no file matches {glob!r} in {config.rootpath}"
        config.issue_config_time_warning(pytest.PytestConfigWarning(text), stacklevel=2)
    return paths


class ScenarioFile(pytest.File):
    """Scenario file: one test per threshold and per specification with a baseline."""

    def collect(self) -> Iterator[pytest.Item]:
        """Yield one item per threshold and comparison; runs nothing."""
        if not self.target.criteria:
            raise self.CollectError(
                f"{self.path}: nothing to check: the scenario has neither thresholds nor a baseline\n"
                f"hint: add thresholds, or save a baseline: avrare check {self.nodeid} --save"
            )
        for number, criterion in enumerate(self.target.criteria):
            yield CriterionItem.from_parent(
                self, name=f"{criterion.specification} {criterion.question}", number=number
            )

    @cached_property
    def target(self) -> CheckTarget:
        """Scenario with its baseline."""
        from avrare.analysis.check.baseline_files import default_folder
        from avrare.analysis.check.targets import load_target
        from avrare.base.errors import AvrareError
        from avrare.scenario.load import load

        try:
            definition = load(self.path)
            folder = default_folder(definition)
            compared = definition.regression is not None or folder.is_dir()
            return load_target(definition, folder, compared, accept=False)
        except AvrareError as error:
            raise self.CollectError("\n".join(error.lines())) from None

    @cached_property
    def outcome(self) -> CheckResult:
        """Verdicts of all items, computed when the first one runs."""
        from avrare.analysis.check.gate import decide
        from avrare.analysis.check.targets import plan_check
        from avrare.estimation.combine.specifications import Execution

        return decide([self.target], plan_check([self.target], None), Execution())


class CriterionItem(pytest.Item):
    """Test of one verdict."""

    def __init__(self, *, number: int, **keywords: Any) -> None:
        super().__init__(**keywords)
        self.number = number

    def runtest(self) -> None:
        """Fail unless the verdict is a pass."""
        from avrare.base.visible_text import spell_controls
        from avrare.estimation.result.verdict import PASSING

        assert isinstance(self.parent, ScenarioFile)
        outcome = self.parent.outcome
        decision = outcome.decisions[self.number]
        text = spell_controls(f"{decision.scenario}  {decision.name}: {decision.verdict}; {decision.reason}")
        # An inconclusive verdict because of rollout errors is not a matter of budget: never skip it.
        too_few = decision.verdict == "inconclusive" and not outcome.has_errors(decision)
        if too_few and self.config.getini("avrare_inconclusive") == "skip":
            pytest.skip(text)
        if decision.verdict not in PASSING:
            raise VerdictError(text)

    def repr_failure(
        self, excinfo: pytest.ExceptionInfo[BaseException], style: TracebackStyle | None = None
    ) -> str | TerminalRepr:
        """Show verdicts and errors of the user without a traceback."""
        from avrare.base.errors import AvrareError

        if isinstance(excinfo.value, AvrareError):
            return "\n".join(excinfo.value.lines())
        if isinstance(excinfo.value, VerdictError):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[Path, int | None, str]:
        """Return the scenario file as the place of the test."""
        return self.path, None, f"{self.path.name}: {self.name}"


class VerdictError(Exception):
    """Verdict other than pass."""


@pytest.fixture
def avrare_result(request: pytest.FixtureRequest) -> Result:
    """Estimate described by the test's ``avrare`` mark; the scenario's path is relative to the test file."""
    mark = request.node.get_closest_marker("avrare")
    if mark is None or mark.args or not {"scenario", "specification"} <= set(mark.kwargs):
        raise pytest.UsageError(f"avrare_result needs a mark: @pytest.mark.{_MARK.split(':')[0]}")
    unknown = set(mark.kwargs) - {"scenario", "specification", "set", "budget", "workers"}
    if unknown:
        raise pytest.UsageError(f"unknown arguments of the mark avrare: {', '.join(sorted(unknown))}")
    from avrare.base.errors import AvrareError

    try:
        return _estimate(request.node.path.parent, **mark.kwargs)
    except AvrareError as error:
        message = "\n".join(error.lines())
    return pytest.fail(message, pytrace=False)


def _estimate(
    folder: Path,
    scenario: str,
    specification: str,
    set: Sequence[str] = (),
    budget: str | None = None,
    workers: int = 1,
) -> Result:
    from avrare.analysis.check.targets import estimate_look, plan_looks
    from avrare.base.errors import UsageError
    from avrare.estimation.combine.specifications import Execution
    from avrare.estimation.plan.budget import Budget
    from avrare.rollout.executors.work import build_executor
    from avrare.rollout.loaded_scenario import LoadedScenario
    from avrare.scenario.load import load

    if workers < 1:
        raise UsageError(f"workers must be at least 1, not {workers}")
    overrides = [set] if isinstance(set, str) else list(set)
    built = LoadedScenario(load(folder / scenario, overrides))
    (look,) = plan_looks(Budget.parse(budget))
    return estimate_look(built, [specification], look, Execution(partial(build_executor, workers)))[0]
