"""Memory of an estimate, foretold before its first rollout: clear words instead of a machine that swaps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.base import batch
from avrare.base.errors import UsageError
from avrare.base.memory import format_memory, usable_memory, used_memory
from avrare.estimation.plan.plan import Estimator, Plan
from avrare.rollout.problem import Problem
from avrare.rollout.request import Carry


@dataclass(frozen=True)
class Demand:
    """Memory that an estimate holds at its peak, beside the chunks that run.

    Attributes:
        bytes: The bytes, as far as they are certain.
        memory: The estimator's option ``memory`` [MiB], None where it is not given.
        sizes: Options that make it smaller, such as "particles".
    """

    bytes: int
    memory: float | None
    sizes: str


@dataclass(frozen=True)
class Forecast:
    """Memory of an estimate.

    Attributes:
        held: Bytes that the estimator holds; 0 where it cannot tell.
        chunk: Bytes of a chunk that is run: in each worker.
        program: Bytes of the program itself.
    """

    held: int
    chunk: int
    program: int

    @property
    def total(self) -> int:
        """Bytes of a run without worker processes."""
        return self.held + self.chunk + self.program

    def describe(self) -> str:
        """Describe the forecast."""
        return (
            f"memory about {format_memory(self.total)}: estimate {format_memory(self.held)}, "
            f"chunk {format_memory(self.chunk)}, program {format_memory(self.program)}"
        )


def forecast(estimator: Estimator, plan: Plan, carry: int) -> Forecast:
    """Foretell the memory of an estimate whose particles' carries have ``carry`` bytes (0: not known).

    Raises:
        UsageError: The estimate needs more than its option ``memory``, or than this process may use.
    """
    demand: Demand = estimator.demand(plan, carry) or Demand(0, None, "")
    size, limit = demand.bytes, demand.memory
    needed = f"the estimate of {', '.join(plan.names[:3])}{' ...' * (len(plan.names) > 3)} needs"
    if limit is not None and size > limit * 2**20:
        raise UsageError(
            f"{needed} {format_memory(size)} of memory, more than the option memory ({limit:g} MiB)",
            f"raise it to {math.ceil(size / 2**20)}, or lower {demand.sizes}",
        )
    # the old states of a chunk, the new ones, and two for the arrays of a step
    rows = 4 * carry + 8 * (plan.steps + 1)
    # the last term: to draw a block of noise
    memory = Forecast(size, plan.chunk * rows + 2**17 * 8 * 16, used_memory())
    if memory.total > (usable := usable_memory()):
        smaller = f"lower {demand.sizes}" if size > memory.chunk else "lower chunk"
        raise UsageError(
            f"{needed} about {format_memory(memory.total)} of memory, and this process may use "
            f"{format_memory(usable)}",
            f"{smaller}, or run it on a larger machine",
        )
    return memory


def measure_carry(problem: Problem) -> int:
    """Return the bytes of a particle's carry at the start; 0 where it cannot be measured without error."""
    try:
        state = problem.system.initial(np.zeros((1, problem.noise_size)))
        signals = problem.system.signals(state)
        updates = [spec.update(spec.start(1), signals) for spec in problem.monitors]
        carry = Carry(state, tuple(u[0] for u in updates), tuple(u[1] for u in updates))
        leaves: list[Any] = [*batch.leaves(carry), *map(np.asarray, signals.values())]
    except (Exception, SystemExit):  # reported where it matters: at the first rollout
        return 0
    return sum(leaf.nbytes for leaf in leaves)
