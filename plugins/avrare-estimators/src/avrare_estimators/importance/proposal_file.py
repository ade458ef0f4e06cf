"""File of learned proposals: one for each specification, to draw from without learning again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from avrare.base.errors import UsageError
from avrare.base.stored_files import read_json
from avrare.estimation.plan.plan import Plan
from avrare_estimators.common.tapes.tape_mixture import TapeMixture

FILE = "learned.json"
"""Name in the run folder."""
_AGAIN = "give the learned.json of a run of this scenario, or leave `learned` out to learn again"


@dataclass(frozen=True)
class ProposalFile:
    """Proposals by specification.

    Attributes:
        mixtures: The proposals.
        path: Where they were read.
    """

    mixtures: Mapping[str, TapeMixture]
    path: str = FILE

    @staticmethod
    def read(path: str | Path) -> ProposalFile:
        """Read a file.

        Raises:
            UsageError: It cannot be read, or holds no proposals.
        """
        if not Path(path).is_file():
            reason = "not a file" if Path(path).exists() else "no such file"
            raise UsageError(f"learned: {path}: {reason}", _AGAIN)
        content = read_json(Path(path), _AGAIN)
        if not content or not all(isinstance(entry, dict) for entry in content.values()):
            raise UsageError(f"learned: {path}: holds no proposals", _AGAIN)
        mixtures = {}
        for name, entry in content.items():
            try:
                mixtures[name] = TapeMixture.from_dict(entry)
            except UsageError as error:
                raise UsageError(f"learned: {path}: {name}: {error.message}", _AGAIN) from None
            if entry.get("digest", mixtures[name].digest) != mixtures[name].digest:
                text = f"learned: {path}: {name} is damaged: it was changed after it was written"
                raise UsageError(text, _AGAIN)
        return ProposalFile(mixtures, str(path))

    def find(self, plan: Plan) -> TapeMixture:
        """Return the proposal of a plan's specification.

        Raises:
            UsageError: There is none, or it is for tapes of another shape.
        """
        name = plan.names[0]
        if name not in self.mixtures:
            names = ", ".join(self.mixtures)
            raise UsageError(f"learned: {self.path}: no proposal for {name}, but for {names}", _AGAIN)
        mixture, shape = self.mixtures[name], (plan.steps + 1, plan.noise.noise_size)
        if mixture.shape != shape:
            theirs, ours = (f"{rows - 1} steps of {size} numbers" for rows, size in (mixture.shape, shape))
            text = f"learned: {self.path}: {name} is for {theirs}, but a rollout has {ours}"
            raise UsageError(text, _AGAIN)
        return mixture


def to_entry(mixture: TapeMixture, names: Sequence[str]) -> dict[str, object]:
    """Return the content of a file's entry, with the names of the noise for people."""
    content = mixture.to_dict()
    for atom in content["atoms"]:
        atom["noise"] = names[atom["channel"]]
    return {**content, "digest": mixture.digest}
