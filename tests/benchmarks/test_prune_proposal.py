"""A learned proposal that is cut down is read like any other."""

import sys
from pathlib import Path

import pytest

from avrare_estimators.importance.proposal_file import ProposalFile
from benchmarks import prune_proposal

KEPT = Path(__file__).parents[2] / "scenarios" / "lane_change_rare.json"


def test_the_largest_components_are_kept(tmp_path, monkeypatch):
    out = tmp_path / "small.json"
    monkeypatch.setattr(sys, "argv", ["prune_proposal.py", str(KEPT), str(out), "--keep", "10"])
    prune_proposal.main()
    (whole,), (small,) = (ProposalFile.read(path).mixtures.values() for path in (KEPT, out))
    shares = sorted((share for share, _ in whole.components), reverse=True)[:10]
    assert [share for share, _ in small.components] == pytest.approx(
        [share / sum(shares) for share, own in whole.components if share >= shares[-1]][:10], abs=1e-5
    )
    assert small.shape == whole.shape
