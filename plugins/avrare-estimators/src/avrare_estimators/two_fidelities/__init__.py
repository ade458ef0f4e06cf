"""Monte Carlo with two fidelities (``mfmc``): a cheap twin on many tapes, the stack on those that matter."""
