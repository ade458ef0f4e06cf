"""Import path of the tests, and the scenario of their packs."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def point(tmp_path):
    """Return a folder with the scenario."""
    from evidence_packs import SCENARIO

    (tmp_path / "point.yaml").write_text(SCENARIO)
    return tmp_path
