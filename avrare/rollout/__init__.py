"""Noise tapes, particles, and the engine that advances them."""
