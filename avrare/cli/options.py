"""Options and closing texts of the commands, as data: their help imports nothing that runs them."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias

from avrare.analysis.compare import REPEAT
from avrare.analysis.failures import FAILURES_FOLDER
from avrare.base.errors import UsageError
from avrare.estimation.plan.budget import Budget
from avrare.plugin.component import KINDS

if TYPE_CHECKING:
    from avrare.output.terminal.console import Mode

EPILOGS = {
    "rate": """\
CATALOGUE lists scenarios with exposures: how often each scene is met, per hour or per km. A
pilot divides one budget among them; rare scenes may name an estimator of their own. See
docs/rates.md.

examples:
  avrare rate scenarios/catalogues/parked_car.yaml --workers 2 --out night
  avrare rate scenarios/catalogues/parked_car.yaml --out night --resume
  avrare rate scenarios/catalogues/motorway_cut_ins.yaml --against reference_driver=fsm

exit code: 0 all thresholds pass (or there are none), 1 a threshold fails, 3 inconclusive, 4 bad
catalogue or command, 6 too many rollout errors
""",
    "check": """\
A threshold passes if the interval of the probability lies below the bound, and fails if it
lies above. Each specification is also compared with the newest baseline, a numbered file in
baselines/NAME next to the scenario, if there is one; the first comparison saves it. See
docs/ci.md.

examples:
  avrare check scenarios/*.yaml --junit report.xml --markdown summary.md
  avrare check drive.yaml --budget rollouts=80000 --looks   # up to four looks, until all are clear
  avrare check drive.yaml --plan                    # estimate the cost of a verdict
  avrare check drive.yaml --save                    # save a new baseline

exit code: 0 all pass, 1 a threshold or comparison fails, 3 inconclusive, 4 bad scenario or
usage, 5 plugin missing, 6 too many rollout errors
""",
    "compare": """\
SCENARIO is a scenario file, or problem:ID for a reference problem with a known probability
('avrare compare problem:' lists them).

NAMES are estimators separated by commas; options of a variant follow after colons:
mc,ams,ams:particles=100:discard=10

examples:
  avrare compare problem:d_rw_L3.8 --estimators mc,ams,is --budget steps=1e6
  avrare compare drive.yaml --specification no_collision --estimators mc,ams \\
      --budget steps=40000 --repeat 5 --truth mc=10000 --workers 4 --out comparison
  avrare compare drive.yaml --against drive_new.yaml --budget rollouts=5000
  avrare compare drive.yaml --against drive.yaml --set against.controller.horizon=15
  avrare compare scenarios/motorway_cut_in.yaml --against reference_driver=cc
""",
    "report": """\
DIR is a folder written by `avrare run`. The report is a single file without external
resources: send it by mail, or archive it with the build.

examples:
  avrare run scenarios/lane_change.yaml --out runs/night
  avrare report runs/night --open
  avrare report runs/night --out pages
""",
}
"""Command -> what follows its options: explanations, examples, exit codes."""

Options: TypeAlias = dict[str, "str | tuple[str, dict[str, Any]] | Options"]
"""Usage -> help, or (help, settings of ``add_argument``); a title, or ``|`` for alternatives -> group."""


def at_least(minimum: int) -> Callable[[str], int]:
    """Return an argparse type for integers of at least ``minimum``."""

    def integer(text: str) -> int:
        try:
            number = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"must be a whole number, not {text!r}") from None
        if number < minimum:
            raise argparse.ArgumentTypeError(f"must be at least {minimum}, not {text}")
        return number

    return integer


def read_rollouts(text: str) -> int:
    """Return N of a budget ``rollouts=N`` (an argparse type)."""
    try:
        budget = Budget.parse(text)
    except UsageError as error:
        raise argparse.ArgumentTypeError(f"must be rollouts=N, not {text!r}: {error.message}") from None
    fewest = 2
    if budget is None or budget.kind != "rollouts" or budget.amount < fewest:
        raise argparse.ArgumentTypeError(f"must be rollouts=N with N of at least {fewest}, not {text!r}")
    return int(budget.amount)


NATURAL: dict[str, Any] = {"type": at_least(0)}
REPEATABLE: dict[str, Any] = {"action": "append", "default": []}
SCENARIO: Options = {"scenario SCENARIO": "scenario file"}
SET: Options = {"--set KEY=VALUE": ("override one value", REPEATABLE)}
SAFE: Options = {
    "--safe": "refuse code that is not of an installed plugin, and files outside the scenario's folder: for "
    "untrusted scenarios"
}
OVERRIDES: Options = {
    "--set KEY=VALUE": ("override one value, e.g. estimator.rollouts=1000; may be repeated", REPEATABLE),
    "--estimator NAME": "use estimator NAME with its defaults instead of the scenario's estimator block",
    **SAFE,
}
SCENARIOS: Options = {"scenarios SCENARIO": ("scenario file", {"nargs": "+"}), **OVERRIDES}
WORKERS: Options = {"--workers N": ("processes (default 1)", {"type": at_least(1), "default": 1})}
SEED: Options = {"--seed N": ("random seed (default: the scenario's)", NATURAL)}
RUN: Options = {
    **SEED,
    **WORKERS,
    "--executor NAME": "executor: serial, processes or ray (with options: ray,address=auto); "
    "default: processes if workers > 1, else serial",
    "--budget KIND=N": "budget per estimate: steps=N, rollouts=N or seconds=N",
}
DISPLAY: Options = {
    "--json": "print JSON and nothing else on stdout",
    "|": {
        "--quiet": "print one line for each answer, and errors",
        "--plain": "no colours, nothing redrawn: for logs",
    },
}
OUTPUT: Options = {"--out DIR": "write the result as JSON into this folder"}
RESUME: Options = {
    "--resume": "go on in the folder of --out where an interrupted command left off, or begin there"
}
RESUMABLE: Options = {**OUTPUT, **RESUME, **DISPLAY, **SAFE}
FAILURES: Options = {
    "--failures DIR": (f"folder of stored failures (default {FAILURES_FOLDER})", {"default": FAILURES_FOLDER})
}
SEARCH: Options = {
    **FAILURES,
    "--budget KIND=N": ("most rollouts, as rollouts=N", {"type": read_rollouts}),
    "--write-blob FILE": "write the failure as text that --blob reads",
}

OPTIONS: dict[str, Options] = {
    "run": {
        "scenarios SCENARIO": ("scenario file", {"nargs": "*"}),
        **OVERRIDES,
        **RUN,
        "--until relative_error=X|threshold=X": "run until the relative error is at most X, or until the "
        "interval excludes X, with an estimator that has this option",
        "--learned FILE": "run with FILE, the learned.json of another run of the estimator, and no pilot",
        "--cross-check": "check each estimate by a smaller one of another family (as `cross_check: true`)",
        "--out DIR": "results folder (default: a new one under runs/)",
        **RESUME,
        "--failures DIR": "replay the failures stored in DIR first, and store new ones there",
        "--no-pictures": "draw no pictures",
        **DISPLAY,
    },
    "check": {
        **SCENARIOS,
        "scenarios SCENARIO": ("scenario file, or one catalogue with thresholds", {"nargs": "+"}),
        **RUN,
        "--looks": "spend the budget in up to four interim looks, until every verdict is decided",
        "baselines": {
            "--baseline DIR": "baseline folder (DIR/NAME for several scenarios); implies a comparison",
            "--save": "save this run as the new baseline",
            "--require-baseline": "stop if there is no baseline; recommended in CI",
            "--accept-changes": "compare even if the scenario has changed since the baseline",
        },
        "decision": {
            "--strict": "exit with 3 where a threshold holds only as far as the search could see",
        },
        "output": {
            "--plan": "only estimate the cost of a verdict",
            "--junit FILE": "write JUnit XML",
            "--markdown FILE": "write a summary for a merge request",
            "--out DIR": "write check.json and the run folders",
            "--resume": "save finished work in the folder of --out, and go on there after an interruption",
        },
        **DISPLAY,
    },
    "rate": {
        "catalogue CATALOGUE": "catalogue file: scenes with exposures",
        **WORKERS,
        "--executor NAME": RUN["--executor NAME"],
        "--budget KIND=N": "budget of all scenes together, the pilot included: steps=N or rollouts=N; "
        "default: the catalogue's",
        "--against CONTROLLER=MODEL": "another driver of the same scenes, such as reference_driver=fsm: how "
        "many times as often the stack breaks each rule",
        "--out DIR": "results folder (default: a new one under runs/)",
        **RESUME,
        **SAFE,
        **DISPLAY,
    },
    "compare": {
        "scenario SCENARIO": "scenario file, or problem:ID",
        "--against OTHER": "second version of the scenario, run on the same noise tapes: a file, or "
        "CONTROLLER=MODEL, such as reference_driver=fsm, which drives in place of the stack",
        "--estimators NAMES": "estimators to compare, e.g. mc,ams,is; with --against that of both versions "
        "(default: Monte Carlo on the same noise)",
        "--budget KIND=N": "budget per estimate: steps=N or rollouts=N",
        "--repeat R": (f"estimates per estimator (default {REPEAT})", {"type": at_least(1)}),
        "--specification NAME": "specification; required if there are several",
        "--truth P": "true probability, or mc=ROLLOUTS to estimate it first",
        "--set KEY=VALUE": (
            "ams.particles=100 for every ams; scenario.steps=20 for the scenario; may be repeated",
            REPEATABLE,
        ),
        **SEED,
        **WORKERS,
        "--out DIR": "write comparison.json, .md and .png",
        "--no-pictures": "draw nothing",
        **SAFE,
        **DISPLAY,
    },
    "validate": {
        **SCENARIOS,
        "scenarios SCENARIO": ("scenario file", {"nargs": "*"}),
        "--build": "also build the stack, run three steps, and compare half the integration step",
        "--schema": "print the JSON schema of scenario files, with the options of all components",
    },
    "replay": {
        "scenario SCENARIO": ("scenario file; optional with --run", {"nargs": "?"}),
        **SET,
        **SAFE,
        "failure": {
            "--failure ID": "ID of a stored failure; with --run: an index",
            "--blob TEXT": "failure as text; @FILE reads it from a file, @- from stdin",
            "--run DIR": "run folder; default: its worst failure",
            "--error K": (
                "with --run: index of a rollout that ended in an error",
                {"type": int},
            ),
            "--specification NAME": "with --run: the violated specification",
        },
        **SEARCH,
        "--shrink": "find the smallest noise that still fails",
        "--lost": "say when it was lost: the last moment from which a drive on without noise keeps the rule",
        "--export FILE": (
            "write the rollout as .csv for `avrare monitor`, .xml (CommonRoad), .mcap (Foxglove) or .rrd "
            "(Rerun); may be repeated",
            REPEATABLE,
        ),
        **DISPLAY,
    },
    "falsify": {
        **SCENARIO,
        **SET,
        **SAFE,
        "--specification NAME": "specification to violate; required if there are several",
        **SEED,
        **SEARCH,
        **DISPLAY,
    },
    "failures": {},
    "failures list": FAILURES,
    "failures blob": {"id ID": "", **FAILURES},
    "failures add": {"run DIR": "folder written by `avrare run`", **FAILURES, **SAFE},
    "why": {
        "folder DIR": "run folder",
        "--specification NAME": "only this specification (default: all with failures)",
        "kinds": {
            "--max-kinds N": ("largest number of kinds (default 6)", {"type": at_least(1), "default": 6}),
            "--method NAME": (
                "kmeans (default), or hdbscan (needs scikit-learn)",
                {"choices": ["kmeans", "hdbscan"], "default": "kmeans"},
            ),
            "--shrink": "also say which noise decides each kind's most typical failure, and when it was lost",
            "--budget KIND=N": (
                "with --shrink: most rollouts for each of them, as rollouts=N (default 3000)",
                {"type": read_rollouts},
            ),
        },
        "attribution": {
            "--fresh N": (
                "fresh tapes for each perfect part, which find the failures that it makes (default 1000)",
                {**NATURAL, "default": 1000},
            ),
            "--channels": "give each noise channel a row of its own",
            "--variant NAME:KEY=VALUE": (
                "another version of the scenario, run on the same tapes; may be repeated, for one NAME too",
                REPEATABLE,
            ),
        },
        **SEED,
        **WORKERS,
        **RESUMABLE,
    },
    "rules": {
        "names NAME": ("show these rules in full; case and '_' are ignored", {"nargs": "*"}),
        "--json": "print a JSON list",
    },
    "report": {
        "folder DIR": "run folder",
        "--out DIR": "write report.html into this folder (default: the run folder)",
        "--open": "open the report in the browser",
        **SAFE,
    },
    "plugins": {
        "--kind KIND": "only components of this kind",
        "--check NAME": "check that a component, or all of a distribution, keep the promises of their kind",
        "--set KEY=VALUE": ("with --check: set an option of the component; may be repeated", REPEATABLE),
        "--timing": "also show the import time of each plugin's descriptions",
        "--json": "print a JSON list",
    },
    "new": {
        "what": ("kind of file to create", {"choices": ["plugin", "scenario", "catalogue"]}),
        "name NAME": "name of the plugin's component, for example wind_gusts, or of the scenario; of a "
        "catalogue, the folder of scenes, or a file",
        "--kind KIND": (
            f"kind of a plugin's component: {', '.join(KINDS)}; several with commas, or repeated",
            REPEATABLE,
        ),
        "--no-driving": "write a perception model, tracker or controller for simulators without vehicles",
        "--simulator NAME": "simulator of the scenario (default: the only one that is installed)",
        "--ego NAME": "with a catalogue: the ego's name in the files of scenes",
        "--stack FILE": "with a catalogue: scenario whose stack and specifications all scenes have (default: "
        "a new one with a controller in Python)",
        "--set KEY=VALUE": ("set an option of the scenario's simulator; may be repeated", REPEATABLE),
        "--act": "also write a controller for the scenario: a function in a Python file",
        "--python": "write a scenario with two Python files of its own: simulator and controller",
        "--out DIR": ("parent of the new folder or file (default: .)", {"default": "."}),
    },
}
"""Command, or command and action -> options."""

_ACTIONS = {
    "failures": {
        "list": "list all failures, one per line",
        "blob": "print one failure as text for `avrare replay --blob`",
        "add": "store the failures of a run",
    }
}


def add_options(parser: argparse.ArgumentParser, command: str) -> None:
    """Add the options of a command."""
    add_rows(parser, OPTIONS[command])
    if command in _ACTIONS:
        actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
        for name, text in _ACTIONS[command].items():
            add_rows(actions.add_parser(name, help=text), OPTIONS[f"{command} {name}"])
    if command in EPILOGS:
        parser.epilog, parser.formatter_class = EPILOGS[command], argparse.RawDescriptionHelpFormatter


def permit_negative_lists(parser: argparse.ArgumentParser) -> None:
    """Read a list such as -1.75,1.75 as a value: it begins with a minus but is not an option."""
    parser._negative_number_matcher = re.compile(r"-\.?\d")


def add_rows(parser: argparse._ActionsContainer, options: Options) -> None:
    """Add the options of a table."""
    for usage, entry in options.items():
        if isinstance(entry, dict):
            titled = usage != "|"
            add_rows(
                parser.add_argument_group(usage) if titled else parser.add_mutually_exclusive_group(), entry
            )
            continue
        name, _, metavar = usage.partition(" ")
        text, settings = entry if isinstance(entry, tuple) else (entry, {})
        if metavar or not name.startswith("-"):
            parser.add_argument(name, metavar=metavar or None, help=text or None, **settings)
        else:
            parser.add_argument(name, action="store_true", help=text)


def overrides(args: argparse.Namespace) -> list[str]:
    """Return the settings of ``--set`` and ``--seed``."""
    return [*args.set, *([f"seed={args.seed}"] if args.seed is not None else [])]


def display(args: argparse.Namespace) -> Mode:
    """Return the display mode that ``--quiet`` and ``--plain`` select."""
    return "quiet" if args.quiet else "plain" if args.plain else "auto"
