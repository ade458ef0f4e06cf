"""File of learned proposals: one for each specification, to draw from without learning again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from avrare.base.errors import UsageError
from avrare.base.stored_files import read_json
from avrare.estimation.plan import Plan
from avrare_estimators.importance.route import Route
from avrare_estimators.importance.tape_mixture import TapeMixture
from avrare_estimators.importance.words import NoiseNames

FILE = "learned.json"
"""Name in the run folder."""
AGAIN = "give the learned.json of a run of this scenario, or leave `learned` out to learn again"


@dataclass(frozen=True)
class ProposalFile:
    """Proposals by specification.

    Attributes:
        mixtures: The proposals.
        routes: Routes of the climbs from them, where there are any.
        path: Where they were read.
    """

    mixtures: Mapping[str, TapeMixture]
    routes: Mapping[str, Route]
    path: str = FILE

    @staticmethod
    def read(path: str | Path) -> ProposalFile:
        """Read a file.

        Raises:
            UsageError: It cannot be read, or holds no proposals.
        """
        if not Path(path).is_file():
            reason = "not a file" if Path(path).exists() else "no such file"
            raise UsageError(f"learned: {path}: {reason}", AGAIN)
        content = read_json(Path(path), AGAIN)
        if not content or not all(isinstance(entry, dict) for entry in content.values()):
            raise UsageError(f"learned: {path}: holds no proposals", AGAIN)
        mixtures, routes = {}, {}
        for name, entry in content.items():
            try:
                mixtures[name] = TapeMixture.from_dict(entry)
                if "climb" in entry:
                    routes[name] = Route.from_dict(entry["climb"], mixtures[name])
            except UsageError as error:
                raise UsageError(f"learned: {path}: {name}: {error.message}", AGAIN) from None
            if "potentials" not in entry:  # smc's digest is of more than the proposal
                check_digest(entry, mixtures[name].digest, f"{path}: {name}")
        return ProposalFile(mixtures, routes, str(path))

    def find(self, plan: Plan) -> TapeMixture:
        """Return the proposal of a plan's specification.

        Raises:
            UsageError: There is none, or it is for tapes of another shape.
        """
        name = plan.names[0]
        if name not in self.mixtures:
            known = ", ".join(self.mixtures)
            raise UsageError(f"learned: {self.path}: no proposal for {name}, but for {known}", AGAIN)
        found = self.mixtures[name]
        check_shape(found.shape, plan, self.path)
        return found


def check_digest(entry: Mapping[str, Any], digest: str, where: str) -> None:
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


def described(mixture: TapeMixture, names: NoiseNames) -> dict[str, Any]:
    """Return the content of a file's entry, with the names of the noise for people."""
    content = mixture.to_dict()
    for atom in content["atoms"]:
        atom["noise"] = names.noise[atom["channel"]]
    return {**content, "digest": mixture.digest}
