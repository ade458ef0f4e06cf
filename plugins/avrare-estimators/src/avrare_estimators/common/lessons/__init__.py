"""Learning of a proposal on the noise tape, and what it has learned in words."""
