"""The rules that the installed plugins offer by name."""

from __future__ import annotations

import difflib
from dataclasses import dataclass

from avrare.errors import PluginError, UsageError
from avrare.plugin.registry import Registry, Row
from avrare.plugin.rulecard import RuleCard

_NEAR, _MOST_NEAR = 0.6, 5
"""How alike the names of rules must be to be suggested (of 1), and how many are."""


@dataclass(frozen=True)
class Offer:
    """A rule and who offers it.

    Attributes:
        card: What it says.
        row: The specification component whose option ``rule`` takes its name.
    """

    card: RuleCard
    row: Row


@dataclass(frozen=True)
class Catalogue:
    """Every rule that can be listed.

    Attributes:
        offers: By plugin, in each plugin's own order.
        broken: What is wrong with plugins whose rules cannot be listed, one line each.
    """

    offers: tuple[Offer, ...]
    broken: tuple[str, ...]

    @classmethod
    def of(cls, registry: Registry) -> Catalogue:
        """Ask every usable specification component for its rules; a failing one breaks no other."""
        offers: list[Offer] = []
        broken: list[str] = []
        for row in registry.rows():
            if row.component is None or not row.component.rules or row.status in ("broken", "incompatible"):
                continue
            try:
                offers += [Offer(_card(card), row) for card in row.component.load_rules()]
            except (Exception, SystemExit) as error:
                reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
                broken.append(f"the rules of {row.name} ({row.origin}) cannot be listed: {reason}")
        return cls(tuple(offers), tuple(broken))

    @property
    def names(self) -> list[str]:
        """The names of the rules."""
        return [offer.card.name for offer in self.offers]

    def find(self, name: str, loosely: bool = False) -> list[Offer]:
        """Every offer of a rule called ``name``, one of each plugin that has it.

        Args:
            name: Of the rule.
            loosely: Whether a name that differs in case, ``_`` and ``-`` only will do.

        Raises:
            PluginError: No plugin offers any rule.
            UsageError: There is no such rule.
        """
        found = [offer for offer in self.offers if offer.card.name == name]
        if not found and loosely:
            found = [offer for offer in self.offers if _plain(offer.card.name) == _plain(name)]
        if not found and not self.offers:
            raise PluginError(
                f"there is no rule {name!r}: no installed plugin offers rules",
                self.broken[0] if self.broken else "pip install avrare-traffic-rules",
            )
        if not found:
            raise UsageError(f"there is no rule {name!r}", self._near(name) or "'avrare rules' lists them")
        return found

    def _near(self, name: str) -> str | None:
        """A hint with the rules whose names are near, nearest first."""
        plain = {_plain(known): known for known in self.names}
        same = plain.get(_plain(name))
        words = [same] if same else [
            plain[word] for word in difflib.get_close_matches(_plain(name), plain, n=_MOST_NEAR, cutoff=_NEAR)
        ]  # fmt: skip
        *others, last = map(repr, sorted(words)) if words else [""]
        return f"did you mean {', '.join(others)}{' or ' if others else ''}{last}?" if words else None


def _plain(name: str) -> str:
    return name.replace("_", "").replace("-", "").lower()


def _card(card: object) -> RuleCard:
    if not isinstance(card, RuleCard):
        raise TypeError(f"it offers {card!r}, which is not a RuleCard")
    return card
