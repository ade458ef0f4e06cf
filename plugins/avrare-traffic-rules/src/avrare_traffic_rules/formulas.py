"""The rules as formulas over the predicates: what a reader checks to know what was tested.

A name without an argument is a predicate of ego and o under a quantifier, of the ego alone outside one.
"""

from __future__ import annotations

from avrare_traffic_rules.config import TrafficRuleConfig

FORMULAS = {
    "R_G1": "forall o in others: always ("
    "in_same_lane and in_front_of and not once[0,{cut_in_time}s](cut_in and prev not cut_in)"
    " -> keeps_safe_distance >= 0)",
    "R_G2": "always (brakes_abruptly -> (exists o in others: precedes"
    " and (not (keeps_safe_distance >= 0) or not brakes_abruptly_relative)))",
    "R_G4": "always (not (exists o in others: in_same_lane and in_front_of and slow) -> preserves_flow >= 0)",
    "R_I2": "forall o in others: always (left_of and drives_faster"
    " -> in_slow_traffic and drives_slightly_faster"
    " or on_access_ramp and on_main_carriageway and not in_slow_traffic)",
    "no_collision": "forall o in others: always (distance > 0)",
}

PUBLISHED = FORMULAS | {
    "R_G2": "always not (brakes and"
    " (brakes_abruptly and not (exists o in others: in_same_lane and in_front_of)"
    " or (exists o in others: keeps_safe_distance and in_same_lane and in_front_of"
    " and brakes_abruptly_relative)))",
}
"""With the one rule that the published code builds differently: any vehicle ahead counts, not the nearest."""


def text(config: TrafficRuleConfig) -> str:
    """The formula of a rule with its parameters filled in."""
    formulas = PUBLISHED if config.definitions == "published" else FORMULAS
    return formulas[config.rule].format(cut_in_time=config.cut_in_time)
