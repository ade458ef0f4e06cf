import json
import os
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from avrare.base import version
from avrare.cli import main as command
from avrare.cli import plugins
from avrare.cli.main import main
from avrare.plugin.provided import COMMAND_GROUP, FUNCTION_GROUP, FUNCTIONS
from avrare.plugin.registry import default_registry

ROOT = Path(__file__).parents[2]
HEAVY = ["torch", "pyro", "casadi", "matplotlib", "plotly", "ray", "pandas", "numba", "gymnasium"]
GOOD = """\
name: toy
steps: 40
simulator: {plugin: box, gap: 20}
specifications:
  near: {plugin: book, rule: R_G1}
estimator: {plugin: toy}
"""


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch, fake):
    """Return a folder with one good scenario, and a registry that sees the fake plugin only."""
    monkeypatch.chdir(tmp_path)
    Path("good.yaml").write_text(GOOD)
    Path("formulas.yaml").write_text(GOOD.replace("{plugin: book, rule: R_G1}", '{stl: "always (gap > 2)"}'))
    default_registry.cache_clear()
    yield tmp_path
    default_registry.cache_clear()


def shell(*words, code, stdout=subprocess.PIPE):
    path = os.pathsep.join([str(ROOT), str(ROOT / "tests" / "plugin" / "fake")])
    return subprocess.run(
        [sys.executable, "-c", code, *words], stdout=stdout, stderr=subprocess.PIPE, text=True, timeout=60,
        env={**os.environ, "PYTHONPATH": path, "AVRARE_PLUGINS": "fake"}, check=False,
    )  # fmt: skip


@pytest.mark.parametrize(
    "words",
    [
        ["--help"],
        ["plugins"],
        ["plugins", "--json"],
        ["rules"],
        ["monitor", "--help"],
        ["validate", "good.yaml"],
        ["validate", "formulas.yaml"],
        ["validate", "--schema"],
        ["run", "--help"],
    ],
)
def test_nothing_heavy_is_imported(words):
    code = (
        "import sys; from avrare.cli.main import main; code = main(sys.argv[1:]);"
        f"print([name for name in {[*HEAVY, 'scipy.stats']} if name in sys.modules], code, file=sys.stderr)"
    )
    assert shell(*words, code=code).stderr.splitlines()[-1] == "[] 0"


def test_help_needs_neither_pydantic_nor_rich():
    code = (
        "import sys; from avrare.cli.main import main; main(['--help']);"
        "print(sorted({'pydantic', 'rich', 'yaml', 'pluggy', 'numpy'} & set(sys.modules)), file=sys.stderr)"
    )
    assert shell(code=code).stderr == "[]\n"


def test_validate_prints_one_line_for_each_scenario(capsys):
    assert main(["validate", "good.yaml", "good.yaml", "--set", "steps=1", "--estimator", "mc"]) == 0
    line = "good.yaml: ok  toy, 1 step, 1 specification, estimator mc\n"
    assert capsys.readouterr() == (line * 2, "")


def test_validate_checks_the_other_files_after_a_mistake(capsys):
    assert main(["validate", "nope.yaml", "good.yaml"]) == 4
    out, err = capsys.readouterr()
    assert out.startswith("good.yaml: ok")
    assert err == "nope.yaml: no such file\nhint: did you mean 'good.yaml'?\n"


@pytest.mark.parametrize(
    ("words", "message", "hint"),
    [
        (["validte", "good.yaml"], "avrare: unknown command 'validte'", "did you mean 'validate'?"),
        (["validate", "--schema", "good.yaml"], "--schema takes no SCENARIO", "validate the scenarios by"),
        (["plugins", "--kind", "trackr"], "--kind: unknown kind 'trackr'", "did you mean 'tracker'?"),
        (["validate"], "avrare validate: SCENARIO is required", "avrare validate SCENARIO, or --schema"),
        (["--verson"], "avrare: unrecognized arguments: --verson", "did you mean '--version'?"),
        (["run", "--bogus"], "avrare run: unrecognized arguments: --bogus", "see avrare run --help"),
    ],
)
def test_usage_errors_exit_4_with_a_hint(capsys, words, message, hint):
    assert main(words) == 4
    first, second = capsys.readouterr().err.splitlines()
    assert first == message
    assert second.startswith(f"hint: {hint}")


def test_help_and_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"avrare {version.__version__}\n"
    for words in ([], ["--help"]):
        assert main(words) == 0
        out = capsys.readouterr().out
        assert all(f"\n  {name} " in out for name in [*command.COMMANDS, *command.PROVIDED])
    assert main(["validate", "--help"]) == 0
    assert "--set KEY=VALUE" in capsys.readouterr().out


class Fails:
    """A command whose execution raises."""

    def __init__(self, error):
        self.error = error

    def add_arguments(self, parser):
        """Add none."""

    def execute(self, args):
        raise self.error


@pytest.fixture
def failing(monkeypatch):
    def failing(error):
        monkeypatch.setitem(sys.modules, "avrare_failing", Fails(error))
        monkeypatch.setitem(command.COMMANDS, "fail", ("avrare_failing", "fails"))

    return failing


def test_a_command_of_a_missing_plugin_gives_the_pip_command(capsys, monkeypatch):
    monkeypatch.setitem(command.PROVIDED, "fly", ("avrare-wings", "flies"))
    assert main(["fly"]) == 5
    first, second = capsys.readouterr().err.splitlines()
    assert first == "avrare fly is provided by avrare-wings, which is not installed"
    assert second == "hint: pip install avrare-wings"


def test_commands_and_functions_name_the_distributions_that_provide_them():
    projects = [tomllib.loads(path.read_text())["project"] for path in ROOT.glob("plugins/*/pyproject.toml")]
    provided = {
        (group, name): project["name"]
        for project in projects
        for group in (COMMAND_GROUP, FUNCTION_GROUP)
        for name in project.get("entry-points", {}).get(group, {})
    }
    commands = {(COMMAND_GROUP, name): distribution for name, (distribution, _) in command.PROVIDED.items()}
    functions = {(FUNCTION_GROUP, name): distribution for name, distribution in FUNCTIONS.items()}
    assert provided == commands | functions


def test_an_internal_error_exits_70(capsys, failing, monkeypatch):
    failing(ZeroDivisionError("one\ntwo"))
    assert main(["fail"]) == 70
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith("this is a bug in avrare: ZeroDivisionError: one two (")
    assert "test_cli.py" in first
    assert "--traceback" in second
    for words in (["fail", "--traceback"], ["--traceback", "fail"]):
        assert main(words) == 70
        assert "Traceback (most recent call last)" in capsys.readouterr().err
    monkeypatch.setenv("AVRARE_TRACEBACK", "1")
    assert main(["fail"]) == 70
    assert "Traceback" in capsys.readouterr().err


def test_an_interruption_exits_2(capsys, failing):
    failing(KeyboardInterrupt())
    assert main(["fail"]) == 2
    assert capsys.readouterr().err == "interrupted\n"


def test_a_closed_pipe_is_not_an_internal_error():
    code = "import sys, os; os.close(0); from avrare.cli.main import main; sys.exit(main(sys.argv[1:]))"
    read, write = os.pipe()
    os.close(read)
    found = shell("validate", "--schema", code=code, stdout=write)
    os.close(write)
    assert (found.returncode, found.stderr) == (141, "")


def test_plugins_lists_components_and_problems(capsys):
    assert main(["plugins", "--json"]) == 0
    rows = {(row["kind"], row["name"]): row for row in json.loads(capsys.readouterr().out)}
    assert rows["tracker", "straight"]["status"] == "ok"
    blind, keys = rows["perception", "blind"], ("status", "distribution", "version", "detail")
    advice = "needs no_such_module: pip install no_such_module"
    assert [blind[key] for key in keys] == ["missing dependency", "avrare-fake", "1.2", advice]
    assert main(["plugins"]) == 0
    out = capsys.readouterr().out
    assert f"blind: {advice}" in out
    assert "avrare-fake 1.2" in out


def test_schema_holds_the_options_of_every_component(capsys):
    assert main(["validate", "--schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    simulators = schema["properties"]["simulator"]["oneOf"]
    (box,) = (one for one in simulators if one["properties"]["plugin"]["const"] == "box")
    assert box["properties"]["gap"]["description"] == "initial gap [m]"
    assert box["additionalProperties"] is False
    reference = box["properties"]["corners"]["items"]["$ref"]
    assert schema["$defs"][reference.removeprefix("#/$defs/")]["properties"]["x"]["type"] == "number"
    names = [choice["properties"]["plugin"]["const"] for choice in schema["properties"]["estimator"]["oneOf"]]
    assert names == ["auto", "mc", "toy"]
    assert "specifications" in schema["properties"]["estimator"]["oneOf"][0]["properties"]


def test_sigterm_ends_any_command_in_words(monkeypatch, capsys):
    before = signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        monkeypatch.setattr(plugins, "execute", lambda args: os.kill(os.getpid(), signal.SIGTERM))
        assert main(["plugins"]) == 2
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    finally:
        signal.signal(signal.SIGTERM, before)
    assert capsys.readouterr().err == "interrupted\n"


@pytest.mark.parametrize("command", ["report", "run --resume --out", "monitor --stl p", "check --baseline"])
def test_a_path_that_cannot_be_looked_at_is_no_bug(command, here, capsys):
    (here / "toy.yaml").write_text(GOOD)
    scenario = ["toy.yaml"] if command.startswith("check") else []
    assert main([*command.split(), "x" * 5000, *scenario]) == 4
    err = capsys.readouterr().err
    assert "File name too long" in err
    assert "bug" not in err


FULL = Path("/dev/full")


@pytest.mark.skipif(not FULL.exists(), reason="a file that takes nothing is a matter of Linux")
@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_output_that_nobody_takes_is_no_bug(stream, here):
    (here / "toy.yaml").write_text(GOOD)
    words = ["rules"] if stream == "stdout" else ["report", "none"]
    with FULL.open("w") as full:
        streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, stream: full}
        done = subprocess.run([sys.executable, "-m", "avrare", *words], text=True, check=False, **streams)
    assert done.returncode == 4
    if stream == "stdout":
        assert done.stderr.startswith("No space left on device\nhint: check the disk")
        assert "bug" not in done.stderr
        assert "Exception ignored" not in done.stderr


def test_output_may_be_closed(monkeypatch):
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    assert main(["rules"]) == 0
    assert main(["report", "none"]) == 4
