"""Nothing is skipped in silence: a skip without a reason from this list fails the session."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

MAY_BE_SKIPPED = {
    r"no Chromium here": "a browser is no Python package",
    r"the (recorded (trajectories|states)|roads|scenes of Euro NCAP|sample scenario|training data) (are|is) "
    r"not here|not beside the checkout": "data in ../shared that the repository may not ship",
    r"'rerun(\.chunk)?'": "rerun-sdk takes 170 MB",
    r"'mlflow'": "mlflow brings some twenty packages",
    r"'pyxodr_omega_prime": "pyxodr is a second opinion, used by one test",
    r"'commonroad_clcs\.pycrccosy'": "commonroad-clcs is a second opinion, compiled, and used by one test",
    r"pythonfmu3?|FMPy is not installed": "FMPy brings some fifteen packages",
    r"no C\+\+ compiler": "the same messages are tested in Python",
    r"MetaDrive is not installed": "MetaDrive needs an environment of its own (its plugin's README.md)",
    r"a matter of (Linux|Unix)|on Linux alone|where a folder should be": "a matter of the platform",
    r"TestEss runs it|TestImportance runs it|test_smc\.py counts them": "it is tested there",
    r"its steps cost more the deeper it goes|it learns in fewer stages": "the budget is tested by hand",
    r"an errored particle is never a parent": "the estimator is made to be wrong",
}
"""Reason of a skip (a regular expression) -> why nothing is lost."""
COLLECTED = pytest.StashKey[set[Path]]()
"""Files of which a test was collected, before any is deselected."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Remember which files have tests."""
    config.stash[COLLECTED] = {item.path for item in items}


@pytest.fixture(scope="session")
def collected_files(pytestconfig: pytest.Config) -> set[Path]:
    """Return the files of which a test was collected."""
    return pytestconfig.stash[COLLECTED]


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail where a skip is not in the list."""
    if _is_controller(session.config) and any(why is None for _, why in _find_skips(session.config)):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print each reason of a skip once, and every skip without one."""
    counts = Counter(_find_skips(config))
    for (text, why), count in sorted(counts.items(), key=str):
        if why is not None:
            terminalreporter.write_line(f"{count} skipped: {text} ({why})")
    for (text, why), _ in sorted(counts.items(), key=str):
        if why is None:
            terminalreporter.write_line(f"skipped without a reason that conftest.py lists: {text}", red=True)


def _find_skips(config: pytest.Config) -> Iterator[tuple[str, str | None]]:
    """Yield the reason of each skip and why nothing is lost; without such a why, name the test as well."""
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    for report in reporter.stats.get("skipped", []):
        reason = str(report.longrepr[2]).removeprefix("Skipped: ")
        why = next((why for words, why in MAY_BE_SKIPPED.items() if re.search(words, reason)), None)
        yield (reason, why) if why is not None else (f"{report.nodeid}: {reason}", None)


def _is_controller(config: pytest.Config) -> bool:
    return not hasattr(config, "workerinput")
