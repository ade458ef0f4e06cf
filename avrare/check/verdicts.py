"""From what the estimates say to verdicts, with the error rates that docs/ci.md promises.

Failing is a union: one claim is enough, so with many claims one would fail by chance. Holm's step-down
procedure ("A simple sequentially rejective multiple test procedure", Scand. J. Statist. 6 (1979)) keeps the
chance that any of them does so at that of a single one, whatever their dependence, and never fails less than
Bonferroni. Passing is an intersection: the gate opens only when every claim passes, which errs no more often
than one of them does (Berger 1982): nothing is to be corrected there.

Repeated looks share the error rate (Bonferroni over looks), so it holds whatever is made of any of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from avrare.check.claims import Claim, Look, look
from avrare.estimation.result import Result

Verdicts = Mapping[int, str]
"""Number of a claim -> "pass" or "fail"; what is still open is not in it."""


def settle(
    claims: Sequence[Claim], results: Callable[[Claim], Result | None], share: float, settled: Verdicts
) -> dict[int, str]:
    """The verdicts after one more look.

    Args:
        claims: All of them.
        results: The estimate of a claim's rule; None where there is none.
        share: Of the error rate, that this look may spend.
        settled: Verdicts of earlier looks; they stay.
    """
    looks = {
        number: look(claim, result, share)
        for number, claim in enumerate(claims)
        if number not in settled and (result := results(claim)) is not None
    }
    verdicts = dict(settled)
    verdicts |= dict.fromkeys(_failed(looks, share, settled, len(claims)), "fail")
    for number, seen in looks.items():
        if number not in verdicts and seen.passes and not doubts(claims[number], results(claims[number])):
            verdicts[number] = "pass"
    return verdicts


def _failed(looks: Mapping[int, Look], share: float, settled: Verdicts, many: int) -> list[int]:
    """Holm's procedure; claims that passed before still count among those that might have failed."""
    left = many - sum(verdict == "fail" for verdict in settled.values())
    failed: list[int] = []
    for number in sorted(looks, key=lambda number: looks[number].blame):
        if looks[number].blame > share / (left - len(failed)):
            break
        failed.append(number)
    return failed


def doubts(claim: Claim, result: Result | None) -> list[str]:
    """Why a claim must not pass, however good its numbers are."""
    found = [f"{name}: {text}" for name, text in result.health.items()] if result is not None else []
    if claim.baseline is not None and claim.baseline.health:
        found.append(f"the baseline was warned of {', '.join(claim.baseline.health)}")
    if claim.baseline is not None and result is not None and claim.baseline.relation != result.relation:
        found.append(f"failure is {result.relation} here, {claim.baseline.relation} in the baseline")
    return found
