from pathlib import Path

import pytest


@pytest.fixture
def fake(monkeypatch):
    """Return the folder of an installed plugin, on the path; no other plugin is let in."""
    folder = Path(__file__).parent / "fake"
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setenv("AVRARE_PLUGINS", "fake")
    return folder
