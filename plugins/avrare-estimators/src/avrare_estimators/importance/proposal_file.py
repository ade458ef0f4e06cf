"""File of learned proposals: one for each specification, to draw from without learning again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from avrare.base.errors import UsageError
from avrare.base.stored_files import read_json
from avrare.estimation.plan.plan import Plan
from avrare_estimators.common.lessons.stored_proposal import AGAIN, FILE, check_digest, check_shape
from avrare_estimators.common.tapes.tape_mixture import TapeMixture


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
            raise UsageError(f"learned: {path}: {reason}", AGAIN)
        content = read_json(Path(path), AGAIN)
        if not content or not all(isinstance(entry, dict) for entry in content.values()):
            raise UsageError(f"learned: {path}: holds no proposals", AGAIN)
        mixtures = {}
        for name, entry in content.items():
            try:
                mixtures[name] = TapeMixture.from_dict(entry)
            except UsageError as error:
                raise UsageError(f"learned: {path}: {name}: {error.message}", AGAIN) from None
            if "potentials" not in entry:  # smc's digest is of more than the proposal
                check_digest(entry, mixtures[name].digest, f"{path}: {name}")
        return ProposalFile(mixtures, str(path))

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
