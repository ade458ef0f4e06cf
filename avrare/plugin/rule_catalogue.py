"""Catalogue of the traffic rules that the installed plugins offer by name."""

from __future__ import annotations

import difflib
from dataclasses import dataclass

from avrare.base.errors import PluginError, UsageError
from avrare.plugin.component import RuleCard
from avrare.plugin.registry import Registry, Row

_SIMILARITY, _MOST_SUGGESTIONS = 0.6, 5
"""Similarity (0 to 1) from which a rule's name is suggested, and the maximal number of suggestions."""


@dataclass(frozen=True)
class Offer:
    """Rule, with the specification component whose option ``rule`` takes its name."""

    card: RuleCard
    row: Row


@dataclass(frozen=True)
class Catalogue:
    """All rules, in each plugin's own order, and a line for each plugin whose rules cannot be listed."""

    offers: tuple[Offer, ...]
    failures: tuple[str, ...]

    @classmethod
    def of(cls, registry: Registry) -> Catalogue:
        """Collect the rules of every usable specification component; failing ones are left out."""
        offers: list[Offer] = []
        failures: list[str] = []
        for row in registry.rows():
            if row.component is None or not row.component.rules or row.status in ("broken", "incompatible"):
                continue
            try:
                offers += [Offer(_card(card), row) for card in row.component.load_rules()]
            except (Exception, SystemExit) as error:
                reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
                failures.append(f"the rules of {row.name} ({row.origin}) cannot be listed: {reason}")
        return cls(tuple(offers), tuple(failures))

    def find(self, name: str, loosely: bool = False) -> list[Offer]:
        """Return the offers of a rule, one for each plugin that has it, or raise an error if there is none.

        ``loosely`` ignores differences in case, ``_`` and ``-``.
        """
        offers = [offer for offer in self.offers if offer.card.name == name]
        if not offers and loosely:
            offers = [offer for offer in self.offers if _plain(offer.card.name) == _plain(name)]
        if not offers and not self.offers:
            raise PluginError(
                f"unknown rule {name!r}: no installed plugin offers rules",
                self.failures[0] if self.failures else "pip install avrare-traffic-rules",
            )
        if not offers:
            raise UsageError(f"unknown rule {name!r}", self._suggest(name) or "'avrare rules' lists them")
        return offers

    def _suggest(self, name: str) -> str | None:
        plain = {_plain(offer.card.name): offer.card.name for offer in self.offers}
        same = plain.get(_plain(name))
        close = difflib.get_close_matches(_plain(name), plain, n=_MOST_SUGGESTIONS, cutoff=_SIMILARITY)
        words = [same] if same else [plain[word] for word in close]
        *others, last = map(repr, sorted(words)) if words else [""]
        return f"did you mean {', '.join(others)}{' or ' if others else ''}{last}?" if words else None


def _plain(name: str) -> str:
    return name.replace("_", "").replace("-", "").lower()


def _card(card: object) -> RuleCard:
    if not isinstance(card, RuleCard):
        raise TypeError(f"it offers {card!r}, which is not a RuleCard")
    return card
