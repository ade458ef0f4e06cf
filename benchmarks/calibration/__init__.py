"""The calibration benchmark: tools that estimate rare failures, on problems with known answers."""
