"""The report in a browser, where there is one."""

import re

import pytest

from avrare.output.report import render_report

FRAMES = """
requestAnimationFrame = (go) => setTimeout(() => go(performance.now()), 16);  // nobody looks: no frames
const box = document.querySelector(".player"), canvas = box.querySelector("canvas");
const slider = box.querySelector("input"), clock = box.querySelector("output");
const scrub = (to) => {
  slider.value = to; slider.dispatchEvent(new Event("input"));
  return [clock.textContent, canvas.toDataURL()];
};
const last = Number(slider.max), [start, middle, end, again] = [0, 20, last, 0].map(scrub);
const frames = [start[1], middle[1], end[1]];
const said = [start[0], middle[0], end[0], new Set(frames).size, again[1] === start[1]];
const area = box.querySelector(".over-time .area"), frame = area.getBoundingClientRect();
const clientX = frame.left + frame.width * 20.5 / (last + 1);
area.dispatchEvent(new PointerEvent("pointerdown", { clientX, clientY: frame.top + 5, buttons: 1 }));
said.push(clock.textContent === middle[0], canvas.toDataURL() === middle[1]);
scrub(0);
box.querySelector(".play").click();
setTimeout(() => { said.push(canvas.toDataURL() !== start[1]); document.title = said.join(", "); }, 500);
"""
WIDE = """
for (const one of document.querySelectorAll("details")) one.open = true;
document.title = `${document.documentElement.scrollWidth} of ${innerWidth}`;
"""


def title(document):
    return re.search(r"<title>(.*?)</title>", document)[1]


@pytest.mark.slow
def test_the_script_runs_under_the_pages_own_policy(made, browse):
    assert 'data-ready="4"' in browse(render_report(made))


@pytest.mark.slow
def test_scrubbing_clicking_and_playing_show_other_frames(lane_change, browse):
    found = browse(render_report(lane_change), FRAMES)
    assert title(found) == "0.00 s, 2.00 s, 3.90 s, 3, true, true, true, true"


@pytest.mark.slow
@pytest.mark.parametrize("which", ["made", "split", "lane_change"])
def test_nothing_overflows_on_a_phone(which, browse, request):
    wide, _, least = title(browse(render_report(request.getfixturevalue(which)), WIDE, width=500)).split()
    assert int(wide) <= int(least)
