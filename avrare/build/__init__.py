"""From a scenario to the parts that run."""
