"""Lines that say what was found: of a replay, a shrunk failure, a search, a sorting."""

from __future__ import annotations

from collections.abc import Sequence

from avrare.build.scenario import BuildableScenario
from avrare.failures.clusters import Clusters
from avrare.failures.divergence import Replayed
from avrare.failures.failure import Failure
from avrare.failures.falsify import Falsified
from avrare.failures.shrink import Shrunk
from avrare.failures.words import describe

SHORT = 1000
"""A blob of at most so many characters is printed; for a longer one it is said how to get it."""

CAUTION = (
    "caution: beta is how far one failure is from the noise-free rollout, no more. exp(-beta^2/2) is no "
    "estimate of the failure probability here, and bounds it on neither side: use `avrare run`"
)


def replayed_lines(found: Replayed) -> list[str]:
    """What came of a stored failure, and what is different."""
    failure, drive = found.failure, found.drive
    now = f"robustness {drive.robustness:.6g}"
    lines = {
        "fails": f"failure {failure.id} is reproduced: {failure.specification} is violated, {now}",
        "passes": f"failure {failure.id} does not fail now: {failure.specification} holds, {now}",
        "error": f"failure {failure.id} breaks down: {drive.error}",
    }
    told = [lines[drive.outcome]]
    if found.divergence is None:
        what = "the signals are" if len(failure.checksums) else "its robustness is"
        return [*told, f"{what} the same to the last bit", *found.differing]
    same = ("scenario and versions are the same: the machine or the code differs",)
    return [*told, found.divergence, *(found.differing or same)]


def shrunk_lines(scenario: BuildableScenario, shrunk: Shrunk) -> list[str]:
    """What is left of a failure, in numbers and in words."""
    if shrunk.after == 0.0:
        lines = [
            f"it fails without any noise ({shrunk.rollouts} rollouts): {describe(scenario, shrunk.noise)}"
        ]
        if shrunk.rescue is not None:
            lines.append(f"it passes with: {describe(scenario, shrunk.rescue)}")
        return lines
    lines = [
        f"shrunk to {shrunk.ratio:.1%} of its norm ({shrunk.before:.3g} -> {shrunk.after:.3g}), "
        f"{shrunk.numbers} of {shrunk.noise.size} numbers ({shrunk.rollouts} rollouts)",
        f"what is left: {describe(scenario, shrunk.noise)}",
    ]
    return lines + ([] if shrunk.reason is None else [f"no tenth of the norm: {shrunk.reason}"])


def falsified_lines(scenario: BuildableScenario, found: Falsified) -> list[str]:
    """What a search found."""
    broken = f", {found.errors} of them broke down" if found.errors else ""
    cost = f"{found.rollouts} rollouts{broken}"
    if found.noise is None:
        return [f"no failure found in {cost}: that is no proof that there is none"]
    words = describe(scenario, found.noise)
    if found.norm == 0.0:
        return [f"it fails without any noise: {words}", "beta = 0", CAUTION]
    more = "" if found.finished else "; the budget ended the search, a larger one may find a likelier failure"
    return [
        f"first failure after {found.until_first} rollouts, norm {found.first:.3g}",
        f"most likely failure found: norm {found.norm:.3g} ({cost}{more})",
        f"what it is: {words}",
        f"beta = {found.norm:.3g}",
        CAUTION,
    ]


def cluster_lines(
    scenario: BuildableScenario, failures: Sequence[Failure], sorted_: Clusters, words: Sequence[str]
) -> list[str]:
    """A line for each kind: how many, its medoid, what that is."""
    count = len(sorted_.medoids)
    quality = f", silhouette {sorted_.silhouette:.2f}" if count > 1 else ""
    what = f"{len(failures)} failure{'s' if len(failures) > 1 else ''} of {scenario.name}"
    lines = [f"{what}: {count} kind{'s' if count > 1 else ''}{quality}"]
    for kind, (medoid, text) in enumerate(zip(sorted_.medoids, words, strict=True)):
        size = int((sorted_.labels == kind).sum())
        lines.append(f"{kind + 1}: {size} like {failures[medoid].id}: {text}")
    return lines
