"""Every command of README, the pages and the plugins' READMEs is run by a test, or has a reason.

A command that is run here meets a small scenario in the place of the page's: its options, its files and the
order of a page's commands are tested, not its numbers.
"""

import glob
import re
import shlex
from pathlib import Path

import pytest

from avrare.cli.main import command_parser, main

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    str(path.relative_to(ROOT))
    for path in [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("plugins/*/README.md")]
    if path.name != "CHANGELOG.md"
)
FENCE = re.compile(r"^ *```(\w*)\n(.*?)^ *```$", flags=re.DOTALL | re.MULTILINE)
PROGRAMS = ("avrare", "make", "pip", "python", "pytest", "git", "rerun")

CONFORMANCE = "tests/testing/conformance/test_docs.py"
ELSEWHERE = {
    "docs/index.md": (CONFORMANCE, ".*"),
    "docs/hours.md": (CONFORMANCE, ".*"),
    "docs/write-a-plugin.md": (CONFORMANCE, ".*"),
    "docs/concepts.md": (CONFORMANCE, ".*"),
    "docs/running.md": ("tests/cli/resume/test_docs.py", ".*"),
    "docs/your-own-simulator.md": ("tests/worlds/test_docs.py", ".* hover.yaml.*"),
}
"""Page -> the test that runs its commands, and a pattern of those."""

NOT_RUN = {
    r"make .*": "sets up or uses the checkout's environment; continuous integration runs the targets",
    r"pip install .*": "installs; tests/packaging/test_wheels.py installs the wheels",
    r"avrare report runs/first_light/.* --open": "of `make run`",
    r"python (benchmarks/|-m benchmarks\.).*": "a study of minutes to hours, whose results the page shows",
    r"avrare compare scenarios/.* --against .* --budget rollouts=5000": "a study, shown on the page",
    r"export .*": "sets a variable of the reader's shell",
    r"avrare run .* --executor ray .*": "needs a cluster; plugins/avrare-ray has tests of the executor",
    r"avrare run scenarios/merge_metadrive.yaml( .*)?": "needs MetaDrive in an environment of its own",
    r"avrare policy convert ppo_merge.zip .*": "needs a trained archive; avrare-policy's tests convert some",
    r"avrare pem fit .*": "a fit of minutes; avrare-pem-training's tests fit logs",
    r"avrare run .* --set perception.model=(models|fitted)/.*": "needs the fit before it",
    r"avrare flow fit .*": "avrare-flows' tests fit flows",
    r"avrare synthesise .*": "a descent of minutes; avrare-design's tests synthesise",
    r"avrare why .*": "needs a large run; tests/cli/test_why.py and tests/analysis",
    r"avrare (sensitivity|require) .*": "needs perception; plugins/avrare-design/tests",
    r"avrare compare .* against.controller.*": "needs a planner; tests/analysis/compare",
    r"avrare (evidence|confirm) .*": "of results made before; plugins/avrare-evidence/tests",
    r"avrare rate .*": "needs drawn options; tests/analysis/rates/test_rates.py",
    r"avrare replay .* --failure 68a0a4be( .*)?": "a failure of the page's own run; tests/analysis/failures",
    r"avrare replay --run runs/night .* --(shrink|lost)": "of the page's own run; tests/analysis/failures",
    r"avrare run drive.yaml --estimator is --learned .*": "a file of the page's own run",
}
"""Pattern of a command -> why no test runs it as it stands."""

SMALLER = {
    "problem:": ["--repeat", "2", "--budget", "steps=100000"],
    "--until": ["--budget", "rollouts=500"],
    "falsify": ["--set", "steps=20", "--budget", "rollouts=600"],
}
"""Word in a command -> options that make it short: the last one counts."""

PERCEPTION = ["perception.detection_range=50", "--set", "steps=3", "--budget", "rollouts=2", "--no-pictures"]
"""Of the real lane change, which has perception: a few steps."""

DRIVE = """\
name: {name}
steps: 10
simulator: {{plugin: linear, dt: 0.1, states: [x], A: [[1]], process_noise: [0.3],
             initial: {{mean: [0], covariance: [0.01]}}}}
specifications:
  safe_distance: {{stl: "always (x < 1.5)"}}
  left_traffic: {{stl: "always (x > -1.5)"}}
  no_collision: {{stl: "always (x < 2)"}}
estimator: {{plugin: mc, rollouts: 200}}
"""


def commands(page):
    """Return the commands of a page, without comments and with their lines joined."""
    text = (ROOT / page).read_text(encoding="utf-8")
    found = []
    for language, body in FENCE.findall(text):
        body = body.replace("\\\n", " ")
        if language == "console":
            found += [line.split("$ ", 1)[1] for line in body.splitlines() if line.lstrip().startswith("$ ")]
        elif language in ("sh", "bash"):
            found += body.splitlines()
    plain = FENCE.sub("", text).replace("\\\n", " ")
    shown = re.findall(rf"^    (?:\$ )?((?:{'|'.join(PROGRAMS)}) .*)$", plain, flags=re.MULTILINE)
    whole = [*found, *(line for line in shown if "[--" not in line)]
    parts = [part for line in whole for part in _words(line)]
    return [part.replace(".venv/bin/", "") for part in parts]


def _words(line):
    words = shlex.split(line, comments=True)
    at = [i for i, word in enumerate(words) if word == "&&"]
    ends = zip([-1, *at], [*at, len(words)], strict=True)
    return [shlex.join(words[begin + 1 : end]) for begin, end in ends if words]


def reason(command):
    """Return why a command is not run, or None."""
    text = " ".join(shlex.split(command))
    return next((why for pattern, why in NOT_RUN.items() if re.fullmatch(pattern, text)), None)


def runs_elsewhere(page, command):
    return page in ELSEWHERE and re.fullmatch(ELSEWHERE[page][1], command) is not None


def avrare_words(command):
    words = [word for word in shlex.split(command) if not re.fullmatch(r"AVRARE_\w+=\w+", word)]
    return words[words.index("avrare") + 1 :] if "avrare" in words and words[0] != "pip" else None


EVERY = [(page, command) for page in PAGES for command in commands(page)]


def test_every_command_is_run_or_has_a_reason():
    assert len(EVERY) > 80
    for page, command in EVERY:
        known = runs_elsewhere(page, command) or reason(command) or avrare_words(command) is not None
        assert known, f"{page}: {command}: run it in a test, or write down why not"
    for page, (test, _) in ELSEWHERE.items():
        assert Path(page).name in (ROOT / test).read_text() or "concepts" in page, (page, test)
    texts = [" ".join(shlex.split(command)) for _, command in EVERY]
    stale = [pattern for pattern in NOT_RUN if not any(re.fullmatch(pattern, text) for text in texts)]
    assert not stale, "no page has such a command any more"


@pytest.mark.parametrize(("page", "command"), EVERY)
def test_the_options_of_every_command_exist(page, command):
    words = avrare_words(command)
    if words is None or words[0].startswith("-"):
        return
    if words[-1] in ("--help", "-h"):
        words.pop()
        command_parser(words[0])
        return
    command_parser(words[0]).parse_args(words[1:])


@pytest.fixture
def stage(tmp_path, monkeypatch):
    """A folder with what the pages' commands name."""
    monkeypatch.chdir(tmp_path)
    for path in ("drive.yaml", "drive_new.yaml", "scenarios/lane_change.yaml", "untrusted/scenario.yaml"):
        Path(path).parent.mkdir(exist_ok=True)
        Path(path).write_text(DRIVE.format(name=Path(path).stem.removesuffix("_new")))
    Path("docs").mkdir()
    Path("docs/cut_in.csv").write_bytes((ROOT / "docs" / "cut_in.csv").read_bytes())
    for source in (path for path in (ROOT / "scenarios").rglob("*") if path.is_file()):
        target = Path("scenarios", source.relative_to(ROOT / "scenarios"))
        target.parent.mkdir(exist_ok=True)
        if not target.exists():
            target.write_bytes(source.read_bytes())
    return tmp_path


def execute(words):
    """Run a command, or build its scenarios where these are a study of their own."""
    rare = {"scenarios/lane_change_rare.yaml": "scenarios/lane_change.yaml", "no_hard_impact": "no_collision"}
    words = [rare.get(word, word) for word in words]
    words = [path for word in words for path in (sorted(glob.glob(word)) if "*" in word else [word])]
    studies = [word for word in words if re.match(r"scenarios/(?!lane_change.yaml)", word)]
    if studies and words[0] == "run":
        return main(["validate", "--build", *studies])
    replaced = {"--open": [], "perception.detection_range=50": PERCEPTION}
    words = [new for word in words for new in replaced.get(word, [word])]
    if PERCEPTION[0] in words:
        words[words.index("scenarios/lane_change.yaml")] = str(ROOT / "scenarios/lane_change.yaml")
    if (other := "against.controller.turn_rate_change_weight=1500") in words:
        words[words.index(other)] = "against.simulator.process_noise=[0.2]"
    more = [extra for key, extra in SMALLER.items() if any(word.startswith(key) for word in words)]
    return main([*words, *(word for extra in more for word in extra)])


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_the_commands_of_a_page_run_in_their_order(page, stage, capsys):
    for command in commands(page):
        if reason(command) or runs_elsewhere(page, command):
            continue
        code = execute(avrare_words(command))
        printed = capsys.readouterr()
        accepted = (0, 1, 3) if avrare_words(command)[0] in ("check", "monitor", "falsify") else (0,)
        assert code in accepted, (command, printed.err)


@pytest.mark.parametrize("page", PAGES)
def test_pictures_exist(page):
    path = ROOT / page
    pictures = re.findall(r"!\[[^]]*\]\(([^)#]+)\)", path.read_text(encoding="utf-8"))
    assert [name for name in pictures if "://" not in name and not (path.parent / name).is_file()] == []
