"""Choice among the stored failures of a run."""

from __future__ import annotations

import shlex

from avrare.base.errors import UsageError, did_you_mean
from avrare.estimation.loop.checkpoint import SCENARIO
from avrare.results.run import Run
from avrare.results.stored_results import RUN_AGAIN


def select_failing(run: Run, specification: str | None = None) -> list[str]:
    """Return the specifications with stored failures, or only the named one.

    Raises:
        UsageError: There are none.
    """
    if specification is not None and specification not in run:
        hint = did_you_mean(specification, list(run))
        raise UsageError(f"{_place(run)}: unknown specification {specification!r}", hint)
    names = [
        name
        for name, result in run.items()
        if len(result.failures.robustness) and specification in (None, name)
    ]
    if not names:
        raise _explain_absence(run, specification)
    return names


def select_failure(run: Run, specification: str | None, index: int | None) -> tuple[str, int]:
    """Return the specification and the number of one stored failure.

    Without a specification only one may have failures; without an index it is the least robust one.

    Raises:
        UsageError: The failure is not stored.
    """
    names = select_failing(run)
    listing = ", ".join(f"{name} ({len(run[name].failures.robustness)})" for name in names)
    if specification is None and len(names) > 1:
        hint = f"choose a specification: {listing}"
        raise UsageError(f"{_place(run)}: several specifications have failures", hint)
    name = names[0] if specification is None else specification
    if name not in names:
        raise UsageError(f"{_place(run)}: no failure of {name} is stored", f"stored: {listing}")
    robustness = run[name].failures.robustness
    if index is not None and not 0 <= index < len(robustness):
        hint = f"it has {len(robustness)} failures, numbered from 0"
        raise UsageError(f"{_place(run)}: {name} has no failure {index}", hint)
    return name, int(robustness.argmin()) if index is None else index


def _explain_absence(run: Run, specification: str | None) -> UsageError:
    # A rollout that broke down has not failed: more of them would not help.
    results = [result for name, result in run.items() if specification in (None, name)]
    lost = next((result for result in results if result.failures.count), None)
    if lost is not None:
        count = f"{lost.failures.count} failures of {lost.specification}"
        text = f"{_place(run)}: {count} are counted, but not stored"
        return UsageError(text, f"failures.npz is missing, or of another run: restore it, or {RUN_AGAIN}")
    worst = max(results, key=lambda result: result.errors)
    warning = worst.health.get("errors")
    counts = f"{worst.errors} of {worst.rollouts} rollouts ended in an error" if worst.errors else ""
    reason = warning or counts
    text = f"{_place(run)}: no failure{f' of {specification}' if specification else ''} is stored"
    hint = "no rollout failed; run more rollouts, or an estimator for rare events"
    if warning is not None and run.folder is not None:
        command = shlex.join(["avrare", "validate", "--build", str(run.folder / SCENARIO)])
        hint = f"mend the stack and run it again; {command} tries its first steps"
    return UsageError(f"{text}: {reason}" if reason else text, hint)


def _place(run: Run) -> str:
    return run.name if run.folder is None else str(run.folder)
