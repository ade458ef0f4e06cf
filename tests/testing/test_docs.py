"""The code on testing estimators in docs/write-a-plugin.md runs."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from avrare.testing.problems import families

TEXT = (Path(__file__).parents[2] / "docs" / "write-a-plugin.md").read_text()
PAGE = TEXT.split("## Test an estimator")[1].split("## The contracts")[0]
PROBLEMS, SUITE = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)


def test_the_problems(capsys):
    exec(PROBLEMS, {})
    first, covers, probability = capsys.readouterr().out.splitlines()
    assert first.startswith("x += 0.1 w")
    assert first.endswith("always (x < 2.5) 0.010618888379036615")
    assert covers == "True"
    assert 0.018 < float(probability) < 0.019


@pytest.mark.slow
def test_the_suite(tmp_path):
    path = tmp_path / "test_mine.py"
    path.write_text(SUITE)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(path)]
    chosen = "budget or certain or other_seeds or (unbiased and count_down)"
    done = subprocess.run([*command, "-k", chosen], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert "4 passed, 2 skipped" in done.stdout, done.stdout


def test_every_generator_is_listed():
    assert not [name for name in families() if f"`{name}(" not in PAGE]
