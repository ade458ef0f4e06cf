"""Sample and its cross-check in common requests: a simulator of batches takes hardly longer for more rows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from avrare.rollout.request import ARRAYS, WANTED_ARRAYS, Request, Rollouts
from avrare_estimators.common.samples.cross_check import CrossCheck
from avrare_estimators.common.samples.sampling import PartialSample
from avrare_estimators.common.samples.scale_annealing import ScaleAnnealing


@dataclass(frozen=True)
class CheckedSample:
    """A sample under way, and beside it a cross-check that began at samples before it (a ``Task``).

    Attributes:
        sample: The sample; its rows fill the chunks of the cross-check's requests.
        check: The cross-check.
    """

    sample: PartialSample
    check: CrossCheck | ScaleAnnealing

    @cached_property
    def pending(self) -> Request | None:
        """The rollouts asked for: the cross-check's first; None when both have ended."""
        requests = [task.pending for task in (self.check, self._wave) if task.pending is not None]
        if len(requests) < 2:
            return requests[0] if requests else None
        return self.sample.source.replay(np.concatenate([request.tape for request in requests]))

    @cached_property
    def _wave(self) -> PartialSample:
        if self.check.pending is None:
            return self.sample
        chunk = self.sample.strata[0].plan.chunk
        return replace(self.sample, wave=min(self.sample.wave, -self.check.pending.rows % chunk))

    def tell(self, rollouts: Rollouts) -> CheckedSample:
        """Continue both."""
        sample, check, rows = self._wave, self.check, 0
        if check.pending is not None:
            rows = check.pending.rows
            check = check.tell(_slice(rollouts, 0, rows))
        if sample.pending is not None:
            sample = sample.tell(_slice(rollouts, rows, len(rollouts.error)))
        return CheckedSample(replace(sample, wave=self.sample.wave), check)


def _slice(rollouts: Rollouts, begin: int, end: int) -> Rollouts:
    arrays = {name: getattr(rollouts, name)[begin:end] for name in (*ARRAYS, *WANTED_ARRAYS)}
    return replace(rollouts, **arrays)
