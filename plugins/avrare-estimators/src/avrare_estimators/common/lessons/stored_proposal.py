"""Entry of a learned proposal in learned.json: its content, and the checks of a reader."""

from __future__ import annotations

from collections.abc import Mapping

from avrare.base.errors import UsageError
from avrare.estimation.plan.plan import Plan
from avrare_estimators.common.lessons.words import NoiseNames
from avrare_estimators.common.tapes.tape_mixture import TapeMixture

FILE = "learned.json"
"""Name in the run folder."""
AGAIN = "give the learned.json of a run of this scenario, or leave `learned` out to learn again"


def check_digest(entry: Mapping[str, object], digest: str, where: str) -> None:
    """Refuse an entry of a file that does not fit its digest, if it has one."""
    if entry.get("digest", digest) != digest:
        raise UsageError(f"learned: {where} is damaged: it was changed after it was written", AGAIN)


def check_shape(found: tuple[int, int], plan: Plan, path: str) -> None:
    """Refuse what was learnt on tapes of another shape."""
    shape = (plan.steps + 1, plan.noise.noise_size)
    if found != shape:
        theirs, ours = (f"{rows - 1} steps of {size} numbers" for rows, size in (found, shape))
        text = f"learned: {path}: {plan.names[0]} is for {theirs}, but a rollout has {ours}"
        raise UsageError(text, AGAIN)


def described(mixture: TapeMixture, names: NoiseNames) -> dict[str, object]:
    """Return the content of a file's entry, with the names of the noise for people."""
    content = mixture.to_dict()
    for atom in content["atoms"]:
        atom["noise"] = names.noise[atom["channel"]]
    return {**content, "digest": mixture.digest}
