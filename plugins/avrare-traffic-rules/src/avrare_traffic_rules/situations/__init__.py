"""Situations made by hand for every rule: what each one means, and the robustness as worked out on paper."""

from avrare_traffic_rules.situations import distances, general, interstate
from avrare_traffic_rules.situations.situation import Car, Situation

SITUATIONS: tuple[Situation, ...] = (*general.SITUATIONS, *interstate.SITUATIONS, *distances.SITUATIONS)

__all__ = ["SITUATIONS", "Car", "Situation"]
