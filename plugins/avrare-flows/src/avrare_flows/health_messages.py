"""Health warnings of this distribution."""

from __future__ import annotations

WARNINGS = {
    "model_error": "the noise comes from a flow fitted to {samples} samples: the interval does not cover its "
    "error; a tenth in the scale can be a factor of ten in the probability",
    "flow_tails": "the weights correct the rows that the fitted flow draws; failures that it hardly ever "
    "draws are missed without a sign: compare with an exact transform, or with another flow",
    "paper_weights": "weights as in stl-ess, Eq. 20: the determinant of the flow without the ratio of the "
    "densities; the estimate converges to E[|det|, failure] / E[|det|], which is not the failure probability",
}
"""Name to text."""
