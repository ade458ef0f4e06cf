"""Text below the options of a command's help."""

from __future__ import annotations

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
