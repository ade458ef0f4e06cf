"""The regression gate: thresholds and baselines, decided with known error rates."""
