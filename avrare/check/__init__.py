"""The gate: do the thresholds hold, and is a rule broken more often than it was?"""
