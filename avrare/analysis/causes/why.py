"""Why a system fails: the kinds of its failures, and the noise that carries them."""

from __future__ import annotations

import os
from dataclasses import dataclass

from avrare.analysis.causes.attribution import Attribution, attribution_of_result
from avrare.analysis.causes.kinds import Kinds, find_kinds
from avrare.base.errors import UsageError
from avrare.base.records import Answer, Records
from avrare.estimation.result.result import Result
from avrare.results.run import Run
from avrare.results.stored_failures import select_failing


@dataclass(frozen=True, repr=False)
class Why(Answer):
    """Causes of the failures of one specification.

    Attributes:
        kinds: Kinds of failure, each with a probability.
        attribution: Noise that carries the failures, and savings by perfect parts; None where fewer
            than two failures are known.
    """

    kinds: Kinds
    attribution: Attribution | None

    def table(self) -> Records:
        """Return one row for each kind; ``attribution.table()`` has one for each group of noise."""
        return self.kinds.table()

    def lines(self) -> list[str]:
        """Describe the kinds, and list the tables of the attribution."""
        if self.attribution is None:
            name = self.kinds.result.specification
            return [*self.kinds.lines(), f"{name}: one failure is too few to attribute"]
        return [*self.kinds.lines(), *self.attribution.lines()]


def why(
    source: Run | Result | str | os.PathLike[str],
    specification: str | None = None,
    *,
    max_kinds: int = 6,
    method: str = "kmeans",
    fresh: int = 1000,
    channels: bool = False,
    seed: int | None = None,
    workers: int = 1,
) -> Why:
    """Sort the failures of a specification into kinds, and attribute them to the noise that carries them.

    Args:
        source: A run or its folder, or the result of a specification.
        specification: Name; None: the only one with failures.
        max_kinds: Largest number of kinds.
        method: "kmeans" or "hdbscan" (needs scikit-learn).
        fresh: Fresh tapes, each run once for every perfect part; 0: none.
        channels: Give each noise channel a row of its own.
        seed: Seed of the fresh noise; None: that of the estimate.
        workers: Number of processes.

    Raises:
        UsageError: Nothing failed, or several specifications have some and none is named.
    """
    result = source if isinstance(source, Result) else _select(source, specification)
    kinds = find_kinds(result, max_kinds, method)
    enough = len(result.failures.robustness) > 1
    return Why(kinds, attribution_of_result(result, fresh, channels, workers, seed) if enough else None)


def _select(source: Run | str | os.PathLike[str], specification: str | None) -> Result:
    run = source if isinstance(source, Run) else Run.read(source)
    names = select_failing(run, specification)
    if len(names) > 1:
        raise UsageError(f"{run.name}: several specifications have failures", f"one of: {', '.join(names)}")
    return run[names[0]]
