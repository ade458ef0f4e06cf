"""Learned parts of ``smc`` in learned.json: the proposal of ``is``, and potentials beside it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from avrare.base.errors import UsageError
from avrare.base.stored_files import read_json
from avrare.estimation.plan.plan import Plan
from avrare_estimators.common.committor.potentials import Potentials
from avrare_estimators.common.lessons.stored_proposal import AGAIN, FILE, check_digest, check_shape, described
from avrare_estimators.common.lessons.words import NoiseNames
from avrare_estimators.common.tapes.tape_mixture import TapeMixture

_POTENTIALS, _CURVE = "potentials", "curve"


@dataclass(frozen=True)
class Learned:
    """Proposal and potentials learnt of a specification, frozen.

    Attributes:
        mixture: Proposal on the noise tape; None: the target.
        potentials: Potentials; None: there are none.
        curve: Robustness levels of the exceedance curve.
        shape: (steps + 1, noise_size) of a tape.
    """

    mixture: TapeMixture | None
    potentials: Potentials | None
    curve: tuple[float, ...]
    shape: tuple[int, int]

    @property
    def digest(self) -> str:
        """16 hexadecimal digits of the content."""
        text = json.dumps(self._content(), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def to_dict(self, names: NoiseNames | None) -> dict[str, object]:
        """Return JSON data, with the names of the noise for people."""
        proposal = described(self.mixture, names) if self.mixture is not None and names is not None else {}
        return {**proposal, **self._content(), "digest": self.digest}

    def _content(self) -> dict[str, object]:
        content: dict[str, Any] = {"steps": self.shape[0] - 1, "noise_size": self.shape[1]}
        if self.mixture is not None:
            content = {**self.mixture.to_dict()}
        content[_POTENTIALS] = self.potentials.to_dict() if self.potentials is not None else None
        return {**content, _CURVE: list(self.curve)}


@dataclass(frozen=True)
class LearnedFile:
    """A learned.json of ``smc``; each entry is read when it is asked for."""

    entries: Mapping[str, Any]
    path: str

    @staticmethod
    def read(path: str | Path) -> LearnedFile:
        """Read a file.

        Raises:
            UsageError: It cannot be read, or holds nothing.
        """
        if not Path(path).is_file():
            reason = "not a file" if Path(path).exists() else "no such file"
            raise UsageError(f"learned: {path}: {reason}", AGAIN)
        content = read_json(Path(path), AGAIN)
        if not content or not all(isinstance(entry, dict) for entry in content.values()):
            raise UsageError(f"learned: {path}: holds nothing that was learnt", AGAIN)
        return LearnedFile(content, str(path))

    def find(self, plan: Plan, features: int | None) -> Learned:
        """Return the entry of a plan's specification, whose states have so many ``features``.

        Raises:
            UsageError: There is nothing, it is for other tapes, steps or features, was left by ``is``, or is
                damaged.
        """
        name = plan.names[0]
        if name not in self.entries:
            raise UsageError(
                f"learned: {self.path}: nothing on {name}, but on {', '.join(self.entries)}", AGAIN
            )
        entry = self.entries[name]
        if _POTENTIALS not in entry:
            raise UsageError(
                f"learned: {self.path}: {name} has a proposal but no potentials: it was left by `is`",
                "give the learned.json of a run with smc, or leave `learned` out to learn again",
            )
        mixture = TapeMixture.from_dict(entry) if "atoms" in entry else None
        try:
            shape = (int(entry["steps"]) + 1, int(entry["noise_size"]))
            stored = entry[_POTENTIALS]
            potentials = Potentials.from_dict(stored) if stored is not None else None
            curve = tuple(float(level) for level in entry[_CURVE])
        except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
            raise UsageError(
                f"learned: {self.path}: {name} is damaged: {type(error).__name__}: {error}", AGAIN
            ) from None
        check_shape(shape, plan, self.path)
        if potentials is not None:
            self._check_potentials(potentials, plan, features)
        learned = Learned(mixture, potentials, curve, shape)
        check_digest(entry, learned.digest, f"{self.path}: {name}")
        return learned

    def _check_potentials(self, potentials: Potentials, plan: Plan, features: int | None) -> None:
        schedule, width = potentials.schedule, potentials.network.centre.shape[1]
        what = f"learned: {self.path}: {plan.names[0]} has potentials"
        if schedule[0] < 0 or schedule[-1] >= plan.steps:
            raise UsageError(
                f"{what} at steps {schedule[0]} to {schedule[-1]}, but a rollout's last step is {plan.steps}",
                AGAIN,
            )
        if features not in (None, width):
            raise UsageError(f"{what} of {width} features, but the system has {features}", AGAIN)


__all__ = ["FILE", "Learned", "LearnedFile"]
