"""Situations for every rule, with the robustness calculated by hand."""

from traffic_situations.situation import Car, Situation
from traffic_situations.table import SITUATIONS

__all__ = ["SITUATIONS", "Car", "Situation"]
