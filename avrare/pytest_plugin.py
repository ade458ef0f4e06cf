"""The pytest plugin: scenario files as tests, and the estimate of a rule as a fixture.

It is loaded with every pytest run where avrare is installed, so it imports nothing beyond pytest until a
scenario is collected or an estimate is asked for.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from avrare.check.gate import Outcome
    from avrare.check.subjects import Subject
    from avrare.estimation.result import Result

_MARK = "avrare(scenario, specification, set=(), budget=None, workers=1): what `avrare_result` estimates"

_SCENARIOS = pytest.StashKey[set[Path]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """The plugin's settings."""
    text = "scenario files to collect as tests: globs, relative to the root folder"
    parser.addini("avrare_scenarios", text, type="linelist", default=[])
    text = "what an inconclusive verdict is: fail or skip"
    parser.addini("avrare_inconclusive", text, default="fail")


def pytest_configure(config: pytest.Config) -> None:
    """Make the mark known, and find the scenario files."""
    config.addinivalue_line("markers", _MARK)
    globs = config.getini("avrare_scenarios")
    config.stash[_SCENARIOS] = {path for glob in globs for path in _matching(config, glob)}


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> ScenarioFile | None:
    """A scenario, if the file is one of those named in ``avrare_scenarios``."""
    known = parent.config.stash[_SCENARIOS]
    return ScenarioFile.from_parent(parent, path=file_path) if file_path in known else None


def _matching(config: pytest.Config, glob: str) -> list[Path]:
    """The files that a glob means; none is worth a warning, for its scenarios would not be tested."""
    try:
        found = list(config.rootpath.glob(glob))
    except (NotImplementedError, ValueError) as error:
        text = f"avrare_scenarios: {glob!r} should be a glob relative to {config.rootpath}: {error}"
        raise pytest.UsageError(text) from None
    if not found:
        text = f"avrare_scenarios: no file matches {glob!r} in {config.rootpath}"
        config.issue_config_time_warning(pytest.PytestConfigWarning(text), stacklevel=2)
    return found


class ScenarioFile(pytest.File):
    """A scenario: one test a threshold, and one for each rule that has a baseline."""

    def collect(self) -> Iterator[pytest.Item]:
        """One item for each claim; nothing runs yet."""
        if not self.subject.claims:
            raise self.CollectError(
                f"{self.path}: nothing to check: it has neither thresholds nor a baseline\n"
                f"hint: add thresholds, or save a baseline: avrare check {self.nodeid} --save"
            )
        for number, claim in enumerate(self.subject.claims):
            yield ClaimItem.from_parent(self, name=f"{claim.specification} {claim.question}", number=number)

    @cached_property
    def subject(self) -> Subject:
        """The scenario with its baseline."""
        from avrare.check.baseline import default_folder
        from avrare.check.subjects import subject
        from avrare.errors import AvrareError
        from avrare.scenario.load import load

        try:
            definition = load(self.path)
            folder = default_folder(definition)
            compared = definition.regression is not None or folder.is_dir()
            return subject(definition, folder, compared, accept=False)
        except AvrareError as error:
            raise self.CollectError("\n".join(error.lines())) from None

    @cached_property
    def outcome(self) -> Outcome:
        """The verdicts, found when the first item runs and shared by all."""
        from avrare.check.gate import decide
        from avrare.check.looks import stages
        from avrare.check.subjects import Machine

        return decide([self.subject], stages(None, None), Machine(1, None, _silent))


class ClaimItem(pytest.Item):
    """One verdict."""

    def __init__(self, *, number: int, **keywords: Any) -> None:
        super().__init__(**keywords)
        self.number = number

    def runtest(self) -> None:
        """Fail unless the verdict is a pass."""
        assert isinstance(self.parent, ScenarioFile)
        outcome = self.parent.outcome
        row = outcome.rows[self.number]
        text = f"{row.scenario}  {row.name}: {row.verdict}; {row.reason}"
        # Broken rollouts are no matter of too few simulations: they are not to be skipped.
        whole = row.verdict == "inconclusive" and not outcome.broken(row)
        if whole and self.config.getini("avrare_inconclusive") == "skip":
            pytest.skip(text)
        if row.verdict != "pass":
            raise VerdictError(text)

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """The verdict without a traceback; also of errors that a user can do something about."""
        from avrare.errors import AvrareError

        if isinstance(excinfo.value, AvrareError):
            return "\n".join(excinfo.value.lines())
        if isinstance(excinfo.value, VerdictError):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[Path, int | None, str]:
        """Where it comes from."""
        return self.path, None, f"{self.path.name}: {self.name}"


class VerdictError(Exception):
    """A verdict that is no pass."""


@pytest.fixture
def avrare_result(request: pytest.FixtureRequest) -> Result:
    """The estimate that the test's ``avrare`` mark asks for; the scenario's path is relative to the test."""
    mark = request.node.get_closest_marker("avrare")
    if mark is None or mark.args or not {"scenario", "specification"} <= set(mark.kwargs):
        raise pytest.UsageError(f"avrare_result needs a mark: @pytest.mark.{_MARK.split(':')[0]}")
    unknown = set(mark.kwargs) - {"scenario", "specification", "set", "budget", "workers"}
    if unknown:
        raise pytest.UsageError(f"the mark avrare does not know {', '.join(sorted(unknown))}")
    from avrare.errors import AvrareError

    try:
        return _estimate(request.node.path.parent, **mark.kwargs)
    except AvrareError as error:
        mistake = "\n".join(error.lines())
    return pytest.fail(mistake, pytrace=False)


def _estimate(
    folder: Path, scenario: str, specification: str, set: Any = (), budget: Any = None, workers: int = 1
) -> Result:
    from avrare.build.scenario import BuildableScenario
    from avrare.check.looks import stages
    from avrare.check.subjects import Machine, estimate
    from avrare.errors import UsageError
    from avrare.estimation.budget import Budget
    from avrare.scenario.load import load

    if workers < 1:
        raise UsageError(f"workers must be at least 1, not {workers}")
    overrides = [set] if isinstance(set, str) else list(set)
    built = BuildableScenario(load(folder / scenario, overrides))
    (stage,) = stages(Budget.parse(budget), None)
    return estimate(built, [specification], stage, Machine(workers, None, _silent))[0]


def _silent(label: str, problem: object) -> Any:
    """No progress line: pytest has its own."""
    from contextlib import nullcontext

    return nullcontext()
