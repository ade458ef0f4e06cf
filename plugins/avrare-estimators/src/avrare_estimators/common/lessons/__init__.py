"""Learning of a proposal on the noise tape, and its description in words."""
