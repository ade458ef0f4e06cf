"""The stack under test: the parts of a scenario, built and joined to a closed loop."""
