"""Every command, name and link of docs/papers.md leads somewhere."""

import pytest

from papers_page import PAGE, find_mistakes

BROKEN = """\
| a | `avrare run scenarios/lane_change.yaml --estimater mc` |
| a | `avrare run scenarios/lane_change.yaml --estimator mcc` |
| a | `avrare run scenarios/lane_change.yaml --set controller.searchh=follow` |
| a | `avrare run scenarios/lane_change.yaml --out a && avrare reprt a` |
| a | `avrare run scenarios/lane_chang.yaml` |
| a | `avrare compare problem:d_rw_L3.9 --estimators mc,ams --budget steps=1e6` |
| a | `avrare compare problem:d_rw_L3.8 --estimators mc,amz --budget steps=1e6` |
| a | `avrare synthesise scenarios/cartpole.yaml --specification off --parameter controller.gain` |
| a | `avrare synthesise scenarios/cartpole.yaml --parameter controller.gane` |
| a | `pytest tests/logic/test_nothing.py` |
| a | `python benchmarks/nothing.py` |
| a | `python benchmarks/case_gaussian.py betaz betas.json betas.png` |
| a | `python benchmarks/table2.py --repeats 3` |
| a | `python benchmarks/stl.py --fast` |
`avrare synthesise --parametre gain`
[a](nothing.md)
[a](slice-sampling.md#nothing)
[a](#nothing)
`kernel: lipschitz_shrinking`
`model: literally`
`weights="papers"`
`controller.backend=ricati`
`avrare_linear.control_search.find_nothing`
`overestimate_bounds`
`--maximize`"""


@pytest.mark.parametrize("line", BROKEN.splitlines())
def test_what_leads_nowhere_is_a_mistake(line):
    assert len(find_mistakes(line)) == 1


def test_everything_on_the_page_exists():
    mistakes = find_mistakes(PAGE.read_text(encoding="utf-8"))
    assert not mistakes, "\n".join(mistakes)
