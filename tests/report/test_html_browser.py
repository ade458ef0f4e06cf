"""The report in a browser, where there is one."""

import re

import pytest

from avrare.report.html.page import report

MOVED = """
requestAnimationFrame = (go) => setTimeout(() => go(performance.now()), 16);  // nobody looks: no frames
const said = [];
const box = document.querySelector(".drive"), play = box.querySelector(".play");
const slider = box.querySelector("input"), cursor = box.querySelector(".cursor");
slider.value = 0; slider.dispatchEvent(new Event("input"));
const first = cursor.style.left;
play.click();
said.push(play.textContent);
setTimeout(() => {
  said.push(cursor.style.left !== first);
  play.click();
  said.push(play.textContent);
  const at = cursor.style.left;
  setTimeout(() => { said.push(cursor.style.left === at); document.title = said.join(" "); }, 300);
}, 700);
"""
THEMES = """
const button = document.getElementById("theme"), said = [];
for (let k = 0; k < 3; k++) {
  button.click();
  const paper = getComputedStyle(document.body).backgroundColor;
  said.push((document.documentElement.dataset.theme || "auto") + " " + paper);
}
document.title = said.join("; ");
"""
WIDE = """
for (const one of document.querySelectorAll("details")) one.open = true;
document.title = `${document.documentElement.scrollWidth} of ${innerWidth}`;
"""


def title(document):
    return re.search(r"<title>(.*?)</title>", document)[1]


def test_the_script_runs_under_the_pages_own_policy(made, browse):
    assert 'data-ready="4"' in browse(report(made))


@pytest.mark.parametrize("which", ["made", "lane_change"])
def test_it_plays_and_pauses(which, browse, request):
    found = browse(report(request.getfixturevalue(which)), MOVED)
    assert title(found) == "Pause true Play true"


def test_both_themes(made, browse):
    dark, light, auto = _themes(browse(report(made), THEMES))
    assert light != dark
    assert auto in (light, dark)


def _themes(document):
    """(dark, light, auto) grounds."""
    found = dict(one.split(" ", 1) for one in title(document).split("; "))
    return found["dark"], found["light"], found["auto"]


@pytest.mark.parametrize("which", ["made", "split", "lane_change"])
def test_nothing_sticks_out_on_a_phone(which, browse, request):
    wide, _, least = title(browse(report(request.getfixturevalue(which)), WIDE, width=500)).split()
    assert int(wide) <= int(least)
