"""The site builds, and every snippet of its own pages runs: Python, scenarios, and the commands of avrare."""

import importlib.util
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from avrare.cli.main import COMMANDS, main
from avrare.plugin.registry import default_registry
from avrare.scenario.yaml import parse

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs"
PARTS = [DOCS / f"{name}.md" for name in ("concepts", "controller", "tracker")]
PAGES = [DOCS / "index.md", DOCS / "write-a-plugin.md", DOCS / "hours.md", *PARTS]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)
NAMED = re.compile(r"^`(\w+\.py)`:\n\n```python\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)
"""Snippets below the name of their file."""
FOREIGN = re.compile(
    r'<(?:script|img|iframe)[^>]*\ssrc="(?:https?:)?//'
    r'|<link[^>]*rel="(?:stylesheet|preconnect)"[^>]*href="(?:https?:)?//'
    r'|<link[^>]*href="(?:https?:)?//[^>]*rel="(?:stylesheet|preconnect)"'
    r"|@import url\([\"']?(?:https?:)?//"
)
"""Attributes that a browser would fetch from another host."""

BLOCK_ONLY = {"perception", "tracker", "controller", "aeb", "timing", "actuators"}
"""Keys of a snippet that is a part of a scenario: laid over the lane change."""


def generator():
    spec = importlib.util.spec_from_file_location("generate", DOCS / "generate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def run_scenario(text, folder):
    plain = parse(text.encode(), "snippet").plain()
    if set(plain) <= BLOCK_ONLY:
        path = folder / "part.yaml"
        if not (folder / "scenarios").exists():  # from an earlier snippet of the page
            (folder / "scenarios").symlink_to(ROOT / "scenarios")
        path.write_text("extends: scenarios/lane_change.yaml\n" + text)
    else:
        path = folder / f"{plain['name']}.yaml"
        path.write_text(text)
    assert main(["validate", str(path)]) == 0


def run_console(text, capsys):
    """Check that each command exits as it says, and prints at least the lines that are shown below it."""
    for part in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]:
        command, *shown = part.splitlines()
        words = shlex.split(command, comments=True)
        if words[0] != "avrare" or words[-1] == "wind_gusts":
            continue  # pip, pytest, and what needs them: tests/cli/test_new.py
        wanted = re.search(r"# exit (\d+)", command)
        capsys.readouterr()
        assert main(words[1:]) == (int(wanted[1]) if wanted else 0), command
        printed = capsys.readouterr()
        missing = [line for line in shown if line not in printed.out + printed.err]
        assert not missing, (command, missing)


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_the_snippets_run(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name, text in NAMED.findall(page.read_text()):
        Path(name).write_text(text)
    for language, text in FENCE.findall(page.read_text()):
        if language == "python":
            exec(compile(text, str(page), "exec"), {"__name__": "snippet"})
        elif language == "yaml":
            run_scenario(text, tmp_path)
        elif language == "console":
            run_console(text, capsys)
        else:
            assert language == "text", language


def test_there_are_snippets_to_run():
    found = [language for page in PAGES for language, _ in FENCE.findall(page.read_text())]
    assert len(PAGES) == 6
    assert min(found.count(language) for language in ("python", "yaml", "console")) >= 4


def test_the_reference_names_everything():
    pages = generator().pages()
    assert [name for name in COMMANDS if f"\n## avrare {name}\n" not in pages["reference/cli.md"]] == []
    components = pages["reference/components.md"]
    for row in default_registry().rows():
        assert f"\n### {row.name}\n" in components
        for name, field in row.component.load_config().model_fields.items():
            assert f"`{field.alias or name}`" in components, (row.name, name)
    for key in ("name", "steps", "specifications", "thresholds", "max_error_rate", "extends"):
        assert f"| `{key}` |" in pages["reference/scenario.md"]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Build the site; return it and what MkDocs said."""
    folder = tmp_path_factory.mktemp("site")
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)
    return folder, done


@pytest.mark.slow
def test_the_site_builds_without_a_warning(site):
    folder, done = site
    assert done.returncode == 0, done.stderr
    assert (folder / "reference" / "cli.html").is_file()


@pytest.mark.slow
def test_nothing_is_fetched_from_elsewhere(site):
    folder, _ = site
    pages = [*folder.rglob("*.html"), *folder.rglob("*.css")]
    assert len(pages) > 20
    assert [page.name for page in pages if FOREIGN.search(page.read_text())] == []
