"""Every test file is collected, and a skip that conftest.py does not allow fails the session."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SKIPS = """
import pytest

def test_runs():
    pass

@pytest.mark.skipif(True, reason="a matter of Unix")
def test_allowed():
    pass

@pytest.mark.skipif({skips}, reason="on Mondays")
def test_unheard_of():
    pass
"""
HIDDEN = """
import pytest

pytest.importorskip("no_such_package")

def test_hidden():
    pass
"""


def test_every_test_file_is_collected(pytestconfig, collected_files):
    """Compare with the files below the folders that the session was asked for."""
    here = pytestconfig.invocation_params.dir
    asked = [(here / argument.partition("::")[0]).resolve() for argument in pytestconfig.args]
    files = {*ROOT.glob("tests/**/test_*.py"), *ROOT.glob("plugins/*/tests/**/test_*.py")}
    wanted = {file for file in files if any(file.is_relative_to(path) for path in asked)}
    assert Path(__file__) in wanted
    assert wanted <= collected_files, f"no test is collected of {sorted(wanted - collected_files)}"


@pytest.fixture
def run(tmp_path):
    """Run pytest in a folder with this repository's conftest.py; return exit code and output."""
    shutil.copy(ROOT / "conftest.py", tmp_path)
    (tmp_path / "pytest.ini").touch()

    def run(text, *options):
        (tmp_path / "test_skips.py").write_text(text)
        words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options]
        alone = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
        done = subprocess.run(words, cwd=tmp_path, env=alone, capture_output=True, text=True, check=False)
        return done.returncode, done.stdout

    return run


@pytest.mark.parametrize("options", [(), pytest.param(("-p", "xdist", "-n", "2"), marks=pytest.mark.slow)])
def test_an_allowed_skip_is_printed_and_any_other_fails_the_session(run, options):
    code, output = run(SKIPS.format(skips=False), *options)
    assert code == 0
    assert "1 skipped: a matter of Unix (a matter of the platform)" in output
    code, output = run(SKIPS.format(skips=True), *options)
    assert code == 1
    words = "skipped without a reason that conftest.py lists: test_skips.py::test_unheard_of: on Mondays"
    assert words in output


@pytest.mark.parametrize("options", [(), pytest.param(("-p", "xdist", "-n", "2"), marks=pytest.mark.slow)])
def test_a_file_that_hides_itself_fails_the_session(run, options):
    code, output = run(HIDDEN, *options)
    assert code == 1
    assert "lists: test_skips.py: could not import 'no_such_package'" in output
