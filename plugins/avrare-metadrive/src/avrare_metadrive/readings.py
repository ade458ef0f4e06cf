"""The numbers that come from MetaDrive's process at every step."""

from __future__ import annotations

DT = 0.1
"""Step between two actions [s]: five of MetaDrive's integration steps."""
RANGE = 50
"""Of the lidar [m]."""
SIGNALS = (
    "x", "y", "heading", "speed", "completion", "remaining", "nearest", "reward",
    "arrived", "crashed", "off_road", "over",
)  # fmt: skip
"""First of them the signals, in this order; then what the expert sees, its rays last.

x and y [m], heading [rad], speed [m/s]; completion of the route in [0, 1], what remains of it [m]; nearest
true reading of the lidar [m]; MetaDrive's reward up to here; the others 0 or 1.
"""
