"""Sequential Monte Carlo with learned potentials."""
