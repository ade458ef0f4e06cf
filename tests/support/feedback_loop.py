"""Scenario of a double integrator with feedback, whose failures are common."""

_SCENARIO = """\
name: loop
steps: 8
seed: 3
chunk: 500
simulator:
  plugin: linear
  states: [x, v]
  inputs: [a]
  A: [[1, 0.3], [0, 1]]
  B: [[0.0], [0.3]]
  process_noise: [0.02, 0.04]
  initial: {{mean: [0, 0], covariance: [[0.02, 0.0], [0.0, 0.02]]}}
  feedback: {{gain: [[0.3, 0.4]]}}
specifications:
  near: {{stl: "always (x < 1.3)"}}
{specifications}estimator: {{plugin: mc, rollouts: {rollouts}}}
"""


def feedback_loop(rollouts: int, specifications: str = "") -> str:
    """Return the text of the scenario; ``specifications`` are further lines of them, indented by two."""
    return _SCENARIO.format(rollouts=rollouts, specifications=specifications)
