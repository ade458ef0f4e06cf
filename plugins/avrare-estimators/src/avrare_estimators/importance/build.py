"""Choice of the sampler by the options."""

from __future__ import annotations

from avrare_estimators.importance.config import IsConfig
from avrare_estimators.importance.importance_sampling import ImportanceSampling
from avrare_estimators.importance.learned_sampling import LearnedSampling
from avrare_estimators.importance.proposal_file import ProposalFile


def build(config: IsConfig, scene: object | None = None) -> ImportanceSampling | LearnedSampling:
    """Build the estimator of a scenario or a call."""
    if not config.learns:
        return ImportanceSampling(config)
    file = ProposalFile.read(config.learned) if config.learned is not None else None
    return LearnedSampling(config, file)
