"""Learning of a proposal on the noise tape."""
