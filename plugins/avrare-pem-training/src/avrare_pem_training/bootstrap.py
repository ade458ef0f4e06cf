"""Bootstrap of a fit: refits to resampled data, which tell how well the data determine the model.

Rows are frames of scenes, so neighbours are alike: contiguous blocks are drawn with replacement, not rows
(Kuensch, Annals of Statistics 17, 1989). A refit has the recipe of the model itself, the schedule that was
found for it included, and the persistence of its errors, which a sample with repeated blocks cannot tell. It
is of the detector alone: the labels as delivered, artefact included, serve the scores of the model card and
no rollout.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from avrare_gp_pem.runtime.variant import FittedPem
from avrare_pem_training.cleaning import CleanedData
from avrare_pem_training.pipeline import Fit, Report, fit_model

_SEED_KEY = 0xB007


def fit_ensemble(fit: Fit, data: CleanedData, members: int, report: Report) -> FittedPem:
    """Return the model with ``members`` refits to bootstrap samples of the training rows."""
    model, plan, refits = fit.model, fit.plan, []
    for number in range(members):
        rng = np.random.default_rng(np.random.SeedSequence(plan.seed, spawn_key=(_SEED_KEY, number)))
        sample = resample(data, rng)
        refit_plan = replace(plan, seed=plan.seed + number + 1)
        refit = fit_model(sample, refit_plan, {}, lambda line: None, whole=False).model
        refits.append(replace(refit, persistence=model.persistence, ghosts=model.ghosts))
        report(f"bootstrap: refit {number + 1} of {members}")
    return replace(model, ensemble=tuple(refits))


def resample(data: CleanedData, rng: np.random.Generator) -> CleanedData:
    """Return the data with blocks of the training rows drawn with replacement, in the order of recording.

    Copies of a block stay together: networks leave blocks out, to calibrate on rows that they have not seen.
    """
    rows = draw_blocks(len(data.train), rng)
    return replace(data, train=data.train.take(rows), oblique=data.oblique[rows])


def draw_blocks(rows: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return the numbers of the rows in a sample of blocks, ascending except for the repeats of a block."""
    blocks = np.array_split(np.arange(rows), min(50, rows))
    chosen = np.sort(rng.integers(len(blocks), size=len(blocks)))
    return np.concatenate([blocks[number] for number in chosen])
