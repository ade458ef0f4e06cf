"""The rules that the installed plugins offer by name."""

from __future__ import annotations

from dataclasses import dataclass

from avrare.errors import PluginError, UsageError, did_you_mean
from avrare.plugin.registry import Registry, Row
from avrare.plugin.rulecard import RuleCard


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

    def find(self, name: str) -> list[Offer]:
        """Every offer of a rule called ``name``, one of each plugin that has it.

        Raises:
            PluginError: No plugin offers any rule.
            UsageError: There is no such rule.
        """
        found = [offer for offer in self.offers if offer.card.name == name]
        if not found and not self.offers:
            raise PluginError(
                f"there is no rule {name!r}: no installed plugin offers rules",
                self.broken[0] if self.broken else "pip install avrare-traffic-rules",
            )
        if not found:
            same = next((known for known in self.names if known.lower() == name.lower()), None)
            near = did_you_mean(same or name, self.names)
            raise UsageError(f"there is no rule {name!r}", near or "'avrare rules' lists them")
        return found


def _card(card: object) -> RuleCard:
    if not isinstance(card, RuleCard):
        raise TypeError(f"it offers {card!r}, which is not a RuleCard")
    return card
