"""Words of the page that no cell changes."""

# ruff: noqa: E501

HEAD = """# How often are rare-event tools wrong?

A tool that estimates a small probability should say how sure it is, and be right about that. A paper shows its tool
on examples of its authors' choice. Here tools meet the same {problems} problems with known answers, from p = 1e-2 to 1e-9
and 2 to 1,000 dimensions, and the black box itself counts what they ask of it. We publish our own among them.

{cells_text}

So many answers tell a tool that is far off from one that is not. With {seeds} of a tool on a problem, true coverage may be as low as
{least} although all intervals hold, and the true share of confidently wrong answers as high as {wrong} although there was none. {truth_text}

{missing_text}

    python -m benchmarks.calibration.environments     # the tools, each in an environment of its own
    python -m benchmarks.calibration --quick          # 30 minutes on two cores
    python -m benchmarks.calibration                  # all budgets and settings

[`table.csv`](calibration/table.csv) has a row for each tool, setting, problem and budget; `cells.zip`
beside it every answer.

## The words

- *Confidently wrong*: no warning, and the 95 % interval misses the truth by more than a factor of three.
  Tools that never warn have no way out of it. So where one estimates 0, or states no coefficient of variation, that counts as
  *no interval*, not as wrong, unless its interval is made for 0 (Clopper-Pearson); and answers that are warned of and as far off are counted below.
- *Covers*: share of the stated intervals that hold the truth.
- *Cost*: relative mean squared error times evaluations. Monte Carlo's is (1 - p) / p; a tool with a tenth
  of it needs a tenth of the evaluations. They are counted: a tool that leaves half of its budget pays half.
- *Trusted*: has three answers or more, states an interval in 90 % of its answers, which cover in 80 % or more, none confidently wrong,
  and the mean is within three standard errors, and 2 %, of the truth. *First*: the least cost of those trusted, of all tools
  at that setting and budget, on problems that five tools of other authors were asked three times.
- *Width*: upper over lower end of the interval, the median. A wide interval covers easily and says little.

## The tools

"""

NOTES = """All shares are in percent; of few answers they are rough. *Trusted on* and *first on* are blank where nothing is judged, for want of three
answers of the tool, or of five tools of others, on any problem. Intervals, sizes and settings are [below](#settings). Not every interval is the tool's own: those of UQpy, pyTAMS, the textbook and SENTIL are
made by us from what the tool states. `verifai cross-entropy` is made to find counterexamples and claims no failure probability: its row shows what
happens to who takes its share of counterexamples for one.

![coverage](calibration/coverage.png)

Blue: a problem; red: all intervals of a tool, with a 95 % interval of the share itself; dotted: nominal. In brackets: problems with an interval. Tools that had
an answer on few problems have met an easier or harder part of them: compare bars only where the brackets agree.

![confidently wrong](calibration/wrong.png)

Orange to red: confidently wrong, as 1/10, in one of ten answers; green: asked, and never confidently wrong; a dash: asked, but no interval stated; blank: not asked, or not expressible.

![cost](calibration/cost.png)

Each mark is a tool on a problem where its answers, three or more, may be trusted; one below the dotted line is cheaper than
Monte Carlo.

Some methods are made for few dimensions, one region or a smooth function. They were asked everywhere all the same, as a user
may not know which a problem is:

{dimension_text}

{warned_text} *Far off*: answers warned of that would otherwise be confidently wrong. Only avrare warns, so only avrare can profit. A warned
answer may be first, as its cost is what it is; but it is of less use, and avrare's warnings often come with a wide interval: see the column *width*.

## Who is first

Problems that five tools of other authors were asked three times. A tool has mostly {first_seeds} there, with which costs that differ by less than
a factor of {factor} may be equal; and the least of many such costs is mostly less than that tool's true one. *Behind*: cost of the best of avrare over that of the first; the letter is the reason, below.
*Not run*: none of avrare's methods for rare events has three answers there yet, so avrare is not judged; *none*: no
method of avrare that was run may be trusted there.

"""

UNSTRUCTURED = "any tool"
"""Key of the reason on problems where nothing leads to a failure."""
REASONS = {
    "openturns form-is": "There is one region, with one most likely point, which FORM finds by gradients in about a "
    "thousand evaluations. avrare asks for no gradient, so it learns a proposal from samples. Needed: a search for "
    "that point where the score is smooth, as a first component of the proposal of `is`.",
    "openturns cross-entropy": "One Gaussian fits the failures, and all evaluations of the last level count. `is` "
    "keeps a quarter of its sample on the target and 15 % for its cross-check: the price of noticing a missed "
    "region. On other problems this tool is at times confidently wrong, see the matrix.",
    "openturns nais": "In few dimensions a kernel density fits any shape of the failures, and all evaluations count. "
    "`is` keeps a quarter of its sample on the target and 15 % for its cross-check.",
    "openturns directional": "In few dimensions a root search along a direction measures a probability, not a hit, "
    "and meets a region that the score does not lead to (`flat`). avrare has no method that uses the geometry of the space of "
    "noise; needed: such a one for d <= 10.",
    "openturns line": "Along the direction of the design point it finds the probability exactly, line by line; needs such a direction, as FORM does.",
    "openturns subset": "Its chains count at every level. `ess` finds its levels in a pilot that does not count, and "
    "cuts the rest into independent runs, to be unbiased and to have an interval from their scatter; at so "
    "small a budget the pilot weighs most.",
    UNSTRUCTURED: "On a problem without structure nothing is to be gained over Monte Carlo; whoever is first is so by chance.",
    "openturns monte carlo": "Nothing is to be gained over Monte Carlo; the two differ by chance alone.",
    "textbook gams": "It is the algorithm of `ams`, without the pilot that chooses the size of the runs; the two "
    "differ by that, and by chance.",
    "sentil splitting": "A kind of splitting as well; the two were not compared in detail.",
    "uqpy subset": "Its chains count at every level, where `ess` pays a pilot that does not count.",
    "pytams tams": "The algorithm of `ams` with one discard at each level.",
    "verifai cross-entropy": "A share of counterexamples that happens to be near the probability.",
}
"""Reasons for which a tool is first where it is before avrare, and what would be needed."""

FINDINGS = """## Settings

*recommended* is a tool's own defaults, with the one size that a user must choose set by the budget, as the table below says. An algorithm
with levels does not know how many it will need: it is given a fifth of the budget for each, so it may take
more or less than the budget; the cost counts what it took. *tuned* is one other
setting, for harder problems; nobody has searched for the best one of any tool.

The full run has ten answers of a tool to a problem in the setting *recommended*, three where an answer takes the tool five CPU
seconds or more, and one at 100,000 evaluations and of *tuned*. What took more than a fifth of the time limit at a tenth of the
budget is not asked: it has no answer, with that reason. At 100,000 an answer had 20 to 60 CPU seconds.

What we did to others' tools, for their authors to check: a worker may take 6 GiB of memory, and an answer the CPU time given above. pyTAMS and VerifAI are asked for one
row at a time, so they meet that limit first: such a missing answer says nothing of their method. For pyTAMS 120 CPU seconds were
not enough for 10,000 evaluations either, on the two problems that were tried again (`ou_4`, `walk_2.5`); for 1,000 it had 8 to 150. OpenTURNS' sampling runs in blocks of 100 rows, directional and line in
blocks of one; `nais` and `line` are of its experimental module. It stops Monte Carlo, directional, line and importance
sampling at a coefficient of variation of 10 %, its default, of which it judges after two blocks (lines, directions) already. FORM starts
at the mean, as in its examples; where the gradient is zero there it stops with an error, and *form-is* and *line* have no
answer. pyTAMS runs its worker in a thread, not a process, so that the black box counts; where one of its ten runs stalls, all trajectories
at one score, it ends with an error, so there is no answer. VerifAI's sampler is called without its server; it is made to find counterexamples, and
its interval is of their share among its samples, which is not the failure probability. SENTIL simulates by itself, so its own count is taken; at these
sizes it is more than the budget on most problems, and the cost counts it.

"""

ABSENT = """The driving problems are NumPy alone, so that any tool can ask them. `perching` is the aircraft of the glider plugin, without its
feedback. The lane change of [scenarios/lane_change.yaml](lane-change.md) (2,609 collisions in 1,000,000 rollouts) is not among them: its tracker and its
compiled controller need avrare's own environment, a rollout takes 6 ms, and the full run of this page would take about 90 hours
of a core for it alone. `lane_change_2m` and `lane_change_0m` stand for it here; avrare's own answers are in
[rare events](rare-events.md), where no other tool was asked.
"""

OWN = """## What it showed of avrare

- **`ce` gives what learning leaves of a budget to the sample that counts.** Where no Gaussian fits, that sample meets failures of large
  weight, and the cost is high: 10,177 on `glider_235cm`, 2,083 on `units`, 76,841 on `misleading`, 76 on `unequal_d10`. Where one fits it is
  4 to 39 (`linear_d2_1e-02`, `lognormal_product_d5`, `following_7m`, `conjunction_2`, `conjunction_2.5`). At 10,000 evaluations, ten seeds
  (100 to 109), 274 of 310 answers are warned of; all intervals hold.
- **The cross-check of `is` is too small at 10,000**: 15 % are 1,500 evaluations, of which 944 go to weights and scouts, and a level of the
  climb takes 360. So below p of about 2e-3 it does not begin, the answer is `unchecked`, and its interval spans a factor of 500. Such
  intervals hold: on the 34 static problems, ten seeds each (100 to 109), 196 of 340 answers were warned of, and all 340 intervals held the truth.
  `check: 0.3` (*tuned*) begins: on 14 of these problems, eight seeds, it warns of 53 instead of 93 of 112 answers, and
  intervals that are not warned of span a factor of two, for up to three times the cost. But a check follows the same score and misses the
  regions that the score hides: of 40 answers each, 45 % covered on `units`, 72 % on `flat` and `flat_d20` and 80 % on `misleading` (none of the
  160 was confidently wrong), where the ten answers each of the default all covered. So it is an option and not the default. Needed: a check that does not
  share the score. These figures and those of `ce` are of other seeds than the cells' (100 and on); this makes as many of theirs
  (`--seeds 40` for the four problems):

      python -m benchmarks.calibration --only "avrare (is|ce) " --budgets 10000 --seeds 10 --no-report

- **`is` gives up on one direction of a hundred numbers** (`linear_d100`, `staircase`): its proposals move few numbers at a time. It
  falls back to Monte Carlo, says 0 and the exact upper limit. `ce` and `ess` have answers there, and `auto` takes `ess`.
  Needed: a Gaussian fit of the elite among the proposals.
- **With ten times the evaluations most warnings go**: one answer to each problem at 100,000, of `ams`, `ess`, `is`, `ce` and `auto`, has
  none that is confidently wrong; the shares that cover and that are warned of are in the table. Only there do `is` and `ce`
  give narrow intervals on most problems: below that their cross-check cannot begin.
- **A mode that takes two rare numbers at once** (`ou_or_coins`: two coins of 1 % at the first step, beside a walk that the score leads to). `auto`, `smc`
  and `ams` (*tuned*) say 2e-5 at 10,000 evaluations, where 1.2e-4 is right. Estimates whose blind bound lies far above
  them are followed by a [look for such pairs](blind-mass.md), and carry the warning `outliers`, so none is confidently wrong. The look is a
  warning and not an estimate, so the intervals miss, and what takes three numbers, or two of later steps, stays unseen. The problem has
  ten answers of avrare and fewer of some others, and so weighs more in avrare's shares.
- **Intervals without a warning hold** about as often as they say (*Warned of*, above). The worst problem is `units`: of the ten answers of `auto` five were not warned of, and four
  of these miss, by a factor of two, as half of its failures lie where the score does not lead.
- **One answer of `is` is confidently wrong** (`regimes_1e-05`, seed 3): it had fallen back to Monte Carlo, and met two failures among 4,335 rows, of
  which 0.04 are expected. An exact 95 % interval is as far off one time in a thousand on a problem as rare as that; of more than a thousand answers that are Monte Carlo's, one is no surprise.
- **Few roots**: at 10,000 evaluations `ess` and `ams` pay a pilot and several runs, each with too few first particles for p
  below 1e-3. Their intervals mostly hold; the warning says that nothing vouches for them.

"""
