"""Words of the page that no cell changes."""

HEAD = """# How often are rare-event tools wrong?

A tool that estimates a small probability should say how sure it is, and be right about that. Papers show
each tool on its authors' examples, at one seed. Here tools meet the same {problems} problems with known
answers, from p = 1e-2 to 1e-9 and 2 to 1,000 dimensions, at many seeds, and the black box itself counts
what they ask of it. We publish our own among them.

**These are {cells:,} answers, a quick part of the full run**: {least} to {most} seeds of each tool and
problem at a budget of {budget} evaluations. A coverage of 95 % cannot be told from one of 85 % on a single
problem by so few; over all problems it can.

    python -m benchmarks.calibration.environments     # the tools, each in an environment of its own
    python -m benchmarks.calibration --quick          # 30 minutes on two cores
    python -m benchmarks.calibration                  # all budgets and settings, 20 seeds

[`table.csv`](calibration/table.csv) has a row for each tool, setting, problem and budget; `cells.zip`
beside it every answer.

## The words

- *Confidently wrong*: no warning, and the 95 % interval misses the truth by more than a factor of three.
  Tools that never warn have no way out of it; so an estimate of 0, or one for which a tool states no
  coefficient of variation, counts as *no interval*, not as wrong.
- *Covers*: share of the stated intervals that hold the truth.
- *Cost*: relative mean squared error times evaluations. Monte Carlo's is (1 - p) / p; a tool with a tenth
  of it needs a tenth of the evaluations. They are counted: a tool that leaves half of its budget pays half.
- *Trusted*: states an interval in 90 % of its answers, which cover in 80 % or more, none confidently wrong,
  and the mean is within three standard errors of the truth. *First*: the least cost of those trusted.

## The tools

"""

NOTES = """All shares are in percent. The tools' names and settings are [below](#settings).

![coverage](calibration/coverage.png)

![confidently wrong](calibration/wrong.png)

![cost](calibration/cost.png)

## Who is first

*Behind*: how many times the cost of the first the best of avrare has.

"""

FINDINGS = """## Settings

*recommended* is a tool's own defaults, with the one size that a user must choose set by the budget.

"""
