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
    from avrare.check.claims import Row
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
    """Make the mark known."""
    config.addinivalue_line("markers", _MARK)


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> ScenarioFile | None:
    """A scenario, if the file is one of those named in ``avrare_scenarios``."""
    config = parent.config
    if _SCENARIOS not in config.stash:
        globs = config.getini("avrare_scenarios")
        config.stash[_SCENARIOS] = {path for glob in globs for path in config.rootpath.glob(glob)}
    return ScenarioFile.from_parent(parent, path=file_path) if file_path in config.stash[_SCENARIOS] else None


class ScenarioFile(pytest.File):
    """A scenario: one test a threshold, and one for each rule that has a baseline."""

    def collect(self) -> Iterator[pytest.Item]:
        """One item for each claim; nothing runs yet."""
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
    def rows(self) -> tuple[Row, ...]:
        """The verdicts, found when the first item runs and shared by all."""
        from avrare.check.gate import decide
        from avrare.check.looks import stages
        from avrare.check.subjects import Machine

        return decide([self.subject], stages(None, None), Machine(1, None, _silent)).rows


class ClaimItem(pytest.Item):
    """One verdict."""

    def __init__(self, *, number: int, **keywords: Any) -> None:
        super().__init__(**keywords)
        self.number = number

    def runtest(self) -> None:
        """Fail unless the verdict is a pass."""
        assert isinstance(self.parent, ScenarioFile)
        row = self.parent.rows[self.number]
        text = f"{row.scenario}  {row.name}: {row.verdict}; {row.reason}"
        if row.verdict == "inconclusive" and self.config.getini("avrare_inconclusive") == "skip":
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
    return _estimate(request.node.path.parent, **mark.kwargs)


def _estimate(
    folder: Path, scenario: str, specification: str, set: Any = (), budget: Any = None, workers: int = 1
) -> Result:
    from avrare.build.scenario import BuildableScenario
    from avrare.check.looks import stages
    from avrare.check.subjects import Machine, estimate
    from avrare.estimation.budget import Budget
    from avrare.scenario.load import load

    built = BuildableScenario(load(folder / scenario, list(set)))
    (stage,) = stages(Budget.parse(budget), None)
    return estimate(built, [specification], stage, Machine(workers, None, _silent))[0]


def _silent(label: str, problem: object) -> Any:
    """No progress line: pytest has its own."""
    from contextlib import nullcontext

    return nullcontext()
