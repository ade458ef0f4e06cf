"""Attack on the command line: mutated inputs of every kind, kills at random moments, every crash point.

``python -m attack`` (``make attack``) is the long one; tests/attack runs a short part of it.
"""
