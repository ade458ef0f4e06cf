"""Folders of short runs, made once."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from avrare.base.stored_files import CHECKSUM, seal
from avrare.cli.main import main
from pushed_point import pushed_point

LANE_CHANGE = str(Path(__file__).parents[2] / "scenarios" / "lane_change_published.yaml")
PLANE = pushed_point(
    1.0,
    specifications='  slow: {stl: "always (v < 1.5 or x < 0)"}\n',
    more="""\
description: A point that is pushed about
thresholds:
  - {specification: left, probability: "< 0.9"}
""",
)


def run(folder, scenario, *words):
    assert main(["run", str(scenario), "--out", str(folder), "--no-pictures", *words]) == 0
    return folder


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """Run a system without vehicles, which fails."""
    folder = tmp_path_factory.mktemp("plane")
    (folder / "plane.yaml").write_text(PLANE)
    return run(folder / "run", folder / "plane.yaml")


@pytest.fixture(scope="session")
def split(tmp_path_factory):
    """Run the same by splitting."""
    folder = tmp_path_factory.mktemp("split")
    (folder / "plane.yaml").write_text(PLANE)
    few = ("particles=40", "discard=4", "runs=4")
    options = [word for one in few for word in ("--set", f"estimator.{one}")]
    return run(folder / "run", folder / "plane.yaml", "--estimator", "ams", *options)


@pytest.fixture(scope="session")
def lane_change(tmp_path_factory):
    """Run a few drives with vehicles, seen, predicted and planned for."""
    folder = tmp_path_factory.mktemp("lane_change") / "run"
    return run(folder, LANE_CHANGE, "--set", "estimator.rollouts=8", "--set", "controller.backend=riccati")


@pytest.fixture
def plane(made, tmp_path):
    """Return a copy to spoil."""
    return Path(shutil.copytree(made, tmp_path / "plane"))


@pytest.fixture
def tamper():
    """Change a JSON file of a folder."""

    def change(folder, name, **values):
        file = folder / name
        content = {**json.loads(file.read_text()), **values}
        file.write_text(json.dumps(seal(content) if CHECKSUM in content else content))

    return change


@pytest.fixture
def browse(tmp_path):
    """Return the document after a browser has run its script, and some lines of ours behind it."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no Chromium here")

    def look(html, lines="", width=1280, height=900):
        begin, end = html.index('<meta http-equiv="Content-Security-Policy"'), html.rindex("</body>")
        if lines:  # the page's own policy lets no other script run
            policy = html[begin : html.index(">", begin) + 1]
            html = html[:end].replace(policy, "") + f"<script>{lines}</script>" + html[end:]
        file = tmp_path / "page.html"
        file.write_text(html, encoding="utf-8")
        words = [
            chromium, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
            "--disable-background-networking", "--disable-component-update", "--disable-sync",
            f"--user-data-dir={tmp_path / 'profile'}", f"--window-size={width},{height}",
            "--virtual-time-budget=4000", "--dump-dom", file.as_uri(),
        ]  # fmt: skip
        return subprocess.run(words, capture_output=True, text=True, timeout=120, check=True).stdout

    return look
