"""Scenario of a point that is pushed along a line: cheap rollouts for tests of commands and reports."""

_SCENARIO = """\
name: plane
steps: {steps}
simulator:
  plugin: linear
  dt: 0.1
  states: [x, v]
  A: [[1, 0.1], [0, 1]]
  process_noise: [0.0, 0.04]
  initial: {{mean: [{mean}, 0], covariance: [{variance}, 0.01]}}
specifications:
  left: {{stl: "always (x < {limit})"}}
{specifications}estimator: {{plugin: mc, rollouts: {rollouts}}}
{more}"""


def pushed_point(
    limit: float, *, steps: int = 20, mean: float = 0.0, variance: float = 0.01, rollouts: int = 400,
    specifications: str = "", more: str = "",
) -> str:  # fmt: skip
    """Return the text of the scenario, whose rule ``left`` is that x stays below ``limit``.

    Args:
        limit: Limit of x.
        steps: Steps of a rollout.
        mean: Mean of x at the start.
        variance: Its variance there.
        rollouts: Rollouts of Monte Carlo.
        specifications: Lines of further specifications, indented by two.
        more: Lines of further keys.
    """
    return _SCENARIO.format(
        limit=limit, steps=steps, mean=mean, variance=variance, rollouts=rollouts,
        specifications=specifications, more=more,
    )  # fmt: skip
