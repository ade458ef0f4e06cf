"""Rollouts: noise tapes, problems, and the engine that advances particles."""
