"""Verdicts of rules on recordings, sample after sample."""

from avrare.stack.builder import build_rule


def judge(name, recording, options=()):
    """Return (violated, robustness) of a rule over a complete recording."""
    rule = build_rule(name, list(options), recording.scene)
    state = rule.start(1)
    for t in range(recording.samples):
        state, verdict = rule.update(state, {key: x[t : t + 1] for key, x in recording.signals.items()})
    return bool(verdict.violated[0]), float(verdict.robustness[0])
