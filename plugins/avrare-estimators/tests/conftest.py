"""Puts this folder on the path, where worker processes find the systems of these tests too."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
