"""Estimates that are interrupted again and again, and go on each time."""

from avrare.base.errors import Interrupted


def interrupt_after(system, calls):
    """Let a system raise ``Interrupted`` at the step after so many."""
    step, done = system.step, 0

    def counted(state, noise):
        nonlocal done
        done += 1
        if done > calls:
            raise Interrupted("killed")
        return step(state, noise)

    system.step = counted


def estimate_through_interruptions(make_problem, estimate, first, further):
    """Return a result, and how many attempts were interrupted before it, each ``further`` steps later."""
    interruptions = 0
    while True:
        problem = make_problem()
        interrupt_after(problem.system, first + further * interruptions)
        try:
            return estimate(problem), interruptions
        except Interrupted:
            interruptions += 1
