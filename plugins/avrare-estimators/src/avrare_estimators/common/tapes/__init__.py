"""Laws of noise tapes to draw from."""
