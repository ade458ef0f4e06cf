"""``avrare new plugin``: the packages it writes pass their own tests, ruff and mypy under any name."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from avrare.cli.main import main
from avrare.plugin.component import KINDS
from avrare.testing.conformance import Subject

ROOT = Path(__file__).parents[2]
TOOLS = Path(sys.executable).parent


def run(words, **environment):
    return subprocess.run(
        [str(word) for word in words], capture_output=True, text=True, check=False, timeout=300,
        env={**os.environ, "OMP_NUM_THREADS": "1", **environment},
    )  # fmt: skip


def make(kind, folder, name):
    kind, *flags = kind.split()
    assert main(["new", "plugin", name, "--kind", kind, *flags, "--out", str(folder)]) == 0
    (source,) = folder.glob(f"avrare-{name.replace('_', '-')}/src")
    return source


def install(source, name):
    """Give a package the metadata of an installed one."""
    info = source / f"avrare_{name}-0.1.0.dist-info"
    info.mkdir()
    (info / "entry_points.txt").write_text(f"[avrare]\n{name} = avrare_{name}\n")
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: avrare-{name}\nVersion: 0.1.0\n")


@pytest.fixture(scope="module")
def packages(tmp_path_factory):
    """Write one package of each kind: kind -> source folder; each with the metadata of an installed one."""
    folder = tmp_path_factory.mktemp("packages")
    sources = {kind: make(kind, folder, f"q{kind}") for kind in KINDS}
    sources["plain"] = make("controller --no-driving", folder, "qplain")
    sources["pair"] = make("simulator,controller", folder, "qpair")
    for kind, source in sources.items():
        install(source, f"q{kind}")
    return sources


@pytest.fixture
def path(packages):
    return os.pathsep.join(map(str, [*packages.values(), ROOT]))


@pytest.mark.slow
def test_their_own_tests_pass(packages, path):
    tests = [source.parent / "tests" for source in packages.values()]
    options = ["-q", "--import-mode=importlib", "-p", "no:cacheprovider", "-p", "no:randomly"]
    options += ["--rootdir", tests[0].parents[1]]
    done = run([sys.executable, "-m", "pytest", *options, *tests], PYTHONPATH=path)
    summary = done.stdout.splitlines()[-1]
    assert done.returncode == 0, done.stdout
    assert "skipped" not in summary
    assert int(summary.split()[0]) > 100, summary


def test_their_tests_call_methods_that_exist(packages):
    texts = [
        file.read_text() for source in packages.values() for file in (source.parent / "tests").glob("*.py")
    ]
    names = {name for text in texts for name in re.findall(r"Subject\.(\w+)", text)}
    assert names
    assert names <= set(dir(Subject))


@pytest.mark.slow
def test_strict_mypy_passes(packages, path):
    modules = [source / f"avrare_q{kind}" for kind, source in packages.items()]
    cache = ["--cache-dir", ROOT / ".mypy_cache"]
    done = run([TOOLS / "mypy", "--strict", *cache, *modules], MYPYPATH=path)
    assert "Success: no issues found in 29 source files" in done.stdout, done.stdout


@pytest.mark.parametrize("name", ["q", "{}_and_18_letters_more"])
def test_ruff_passes(name, tmp_path):
    for kind in [*KINDS, "controller --no-driving", ",".join(KINDS)]:
        make(kind, tmp_path / kind, name.format(kind[:4]))
    for command in (["check", "--no-cache"], ["format", "--check", "--no-cache"]):
        done = run([TOOLS / "ruff", *command, tmp_path])
        assert done.returncode == 0, done.stdout


def test_the_next_commands_are_printed(tmp_path, capsys):
    make("tracker", tmp_path, "alpha-beta")
    out = capsys.readouterr().out
    assert out.startswith(f"{tmp_path}/avrare-alpha-beta: tracker 'alpha_beta'\n")
    assert "avrare plugins --check alpha_beta" in out


@pytest.mark.slow
def test_a_template_with_more_noise_passes_its_tests(tmp_path):
    source = make("simulator --kind controller", tmp_path, "more")
    file = source / "avrare_more" / "simulator.py"
    text = file.read_text().replace("noise_size = 1", "noise_size = 2")
    text = text.replace('("gust",)', '("gust", "rain")')
    file.write_text(text.replace("noise[:, 0]", "(noise[:, 0] + noise[:, 1])"))
    install(source, "more")
    path = os.pathsep.join(map(str, [source, ROOT]))
    done = run([sys.executable, "-m", "pytest", "-q", source.parent], PYTHONPATH=path)
    assert done.returncode == 0, done.stdout
    assert "skipped" not in done.stdout.splitlines()[-1]


def test_nothing_is_overwritten(tmp_path, capsys):
    source = make("tracker", tmp_path, "mine")
    (source.parent / "README.md").write_text("mine")
    assert main(["new", "plugin", "mine", "--kind", "controller", "--out", str(tmp_path)]) == 4
    assert f"{tmp_path}/avrare-mine: already exists" in capsys.readouterr().err
    assert (source.parent / "README.md").read_text() == "mine"
    assert sorted(path.name for path in (source / "avrare_mine").iterdir()) == [
        "__init__.py", "py.typed", "tracker.py", "tracker_config.py",
    ]  # fmt: skip


@pytest.mark.parametrize("call", range(0, 8, 3))
def test_a_command_that_was_killed_can_be_repeated(tmp_path, monkeypatch, call):
    """Repeat it: half a package had the name of the whole one, which was refused from then on."""
    write, left = Path.write_text, [call]

    def dying(*words, **options):
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt  # no code of the command runs after a kill either
        return write(*words, **options)

    monkeypatch.setattr(Path, "write_text", dying)
    assert main(["new", "plugin", "mine", "--kind", "tracker", "--out", str(tmp_path)]) == 2
    assert not (tmp_path / "avrare-mine").exists()
    monkeypatch.setattr(Path, "write_text", write)
    make("tracker", tmp_path, "mine")
    assert [path.name for path in tmp_path.iterdir()] == ["avrare-mine"]


@pytest.mark.parametrize("name", ["", "../up", "Mine", "é", "a--b", "-", "x" * 25, "avrare-", "a\nb"])
def test_bad_names_get_one_clear_line(name, tmp_path, capsys):
    assert main(["new", "plugin", f"--out={tmp_path}", "--kind", "tracker", "--", name]) == 4
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert lines[0] == f"{name!r} is not a valid plugin name"
    assert lines[1].startswith("hint: use lowercase letters and digits")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["mpc", "--kind", "controller"], "the controller 'mpc' already exists in avrare-mpc"),
        (["serial", "--kind", "executor"], "the executor 'serial' already exists in avrare"),
        (["mine", "--kind", "controler"], "unknown kind 'controler'\nhint: did you mean 'controller'?"),
        (["mine"], "--kind is required for a plugin"),
        (["mine", "--kind", "tracker", "--out", "/proc/nowhere"], "cannot be written"),
    ],
)
def test_other_mistakes(words, text, capsys):
    assert main(["new", "plugin", *words]) == 4
    assert text in capsys.readouterr().err


def test_a_new_scenario_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "scenario", "spill", "--simulator", "tank", "--set", "start=0.5"]) == 0
    assert "signals level" in capsys.readouterr().out
    text = Path("spill.yaml").read_text()
    assert "  start: 0.5\n" in text
    assert "  # rim: 2.0   # height of the rim above the valve [m]" in text
    assert main(["validate", "--build", "spill.yaml"]) == 0
    assert main(["run", "spill.yaml", "--budget", "rollouts=20", "--quiet", "--no-pictures"]) == 0


@pytest.mark.parametrize(
    ("words", "obstacle"),
    [
        (["gymnasium", "--set", "env=Pendulum-v1"], "this environment needs a controller"),
        (["highway_env"], "highway_env needs a controller"),
    ],
)
def test_a_new_scenario_says_that_it_needs_a_controller(words, obstacle, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "scenario", "first", "--simulator", *words]) == 0
    out = capsys.readouterr().out
    assert f"it does not run yet: {obstacle}\nnext: add a `controller:`" in out
    assert "or repeat with --act, which writes a first controller; then avrare validate --build" in out
    assert main(["new", "scenario", "first", "--simulator", *words, "--act"]) == 0
    assert "next: avrare validate --build first.yaml && avrare run first.yaml\n" in capsys.readouterr().out
    assert main(["validate", "--build", "first.yaml"]) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--simulator", "tankk"], "did you mean 'tank'"),
        ([], "--python writes a simulator and a controller"),
        (["--simulator", "single_track"], "such as {x: 0, y: 0, speed: 30}"),
        (["--simulator", "tank", "--set", "rimm=3"], "did you mean 'rim'"),
        (["--simulator", "tank", "--kind", "tracker"], "are for plugins"),
    ],
)
def test_a_new_scenario_that_cannot_be_written(words, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "scenario", "spill", *words]) in (4, 5)
    assert message in capsys.readouterr().err
    assert not Path("spill.yaml").exists()


def test_a_new_python_scenario_runs_and_its_file_passes_the_checks(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "scenario", "acc", "--python"]) == 0
    assert "next: avrare validate --build acc.yaml && avrare run acc.yaml\n" in capsys.readouterr().out
    assert main(["run", "acc.yaml", "--set", "estimator={plugin: mc, rollouts: 50}", "--out", "run"]) == 0
    for kind, file in (("simulator", "acc.py"), ("controller", "acc_controller.py")):
        words = ["plugins", "--check", "python", "--kind", kind, "--set", f"file={file}", "--set"]
        assert main([*words, f"class={kind.capitalize()}"]) == 0
        assert "0 failed, 0 skipped" in capsys.readouterr().out
    assert main(["new", "scenario", "acc", "--python", "--simulator", "tank"]) == 4
    Path("acc.py").write_text("mine")
    assert main(["new", "scenario", "acc", "--python"]) == 4
    assert "acc.py: already exists" in capsys.readouterr().err


def test_a_gate_compares_versions_of_the_controller_of_a_new_python_scenario(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "scenario", "acc", "--python"]) == 0
    words = ["check", "acc.yaml", "--set", "estimator={plugin: mc, rollouts: 2000}"]
    assert main([*words, "--save"]) == 0
    controller, simulator = Path("acc_controller.py"), Path("acc.py")
    controller.write_text(controller.read_text().replace("time_gap=1.3", "time_gap=1.3, margin=0.0"))
    assert main(words) in (0, 3)
    controller.write_text(controller.read_text().replace("-8.0, 2.0", "-4.0, 2.0"))
    assert main(words) == 1
    simulator.write_text(simulator.read_text().replace("0.95 * world.error", "0.9 * world.error"))
    capsys.readouterr()
    assert main(words) == 4
    error = capsys.readouterr().err
    assert "simulator.file: its file has changed" in error
    assert "--accept-changes" in error


def test_a_new_scenario_goes_on_with_its_controller(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["new", "scenario", "spill", "--simulator", "gymnasium", "--set", "env=Pendulum-v1", "--act"]
    assert main(words) == 0
    scenario = Path("spill.yaml")
    before = scenario.read_text()
    scenario.unlink()  # as if killed between the two files
    assert main(words) == 0
    assert scenario.read_text() == before
    scenario.unlink()
    Path("spill.py").write_text("mine")
    assert main(words) == 4
    assert "spill.py: already exists" in capsys.readouterr().err


def test_a_catalogue_needs_a_simulator_that_reads_scenes(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "catalogue", ".", "--simulator", "python"]) == 4
    assert "simulator 'python' reads no files of scenes" in capsys.readouterr().err
    assert main(["new", "catalogue", ".", "--python"]) == 4
    assert "a catalogue takes" in capsys.readouterr().err
    assert not any(tmp_path.iterdir())
