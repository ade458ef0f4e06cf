"""Nested levels with Markov chains on the noise tape: kernels, chains, and a pass down the levels."""
