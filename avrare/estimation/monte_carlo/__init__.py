"""Monte Carlo, its stopping rules, and two-fidelity Monte Carlo."""
