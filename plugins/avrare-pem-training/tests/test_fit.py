"""Fits of every kind on made-up drives whose law is known, and the commands."""

import json
from dataclasses import replace

import numpy as np
import pytest

from avrare.cli.main import main
from avrare_gp_pem.runtime.features import Box
from avrare_gp_pem.runtime.store import load
from avrare_gp_pem.runtime.student_t import student
from avrare_pem_training.cleaning import clean
from avrare_pem_training.scores import ErrorFit, evaluate
from avrare_pem_training.table import write_table

RANGES = np.array([10.0, 25.0, 40.0, 50.0, 70.0])


def quick(model):
    """Return a plan that takes a second or two."""
    from avrare_pem_training.fit_gp import Schedule
    from avrare_pem_training.pipeline import RECIPES, FitPlan

    if model == "gp":
        schedule = Schedule(inducing=15, steps=200, batch=128, checks=1, weight=1.0, diagonal=True)
        return FitPlan("gp", schedule=schedule)
    short = {"members": 3, "epochs": 8, "least_steps": 250, "least_gain": np.inf, "batch": 256}
    return FitPlan(model, recipe=replace(RECIPES[model][0], **short))


def cars(distance, yaw=None):
    """Return (len(distance), 60) cars all around the ego, of any yaw or of one."""
    rng = np.random.default_rng(0)
    bearing, turned = rng.uniform(-np.pi, np.pi, (2, 60))
    one = np.ones((len(distance), 60))
    sizes = (size * one for size in (4.6, 1.9, 1.7, 3.0))
    place = (distance[:, None] * part(bearing) for part in (np.cos, np.sin))
    return Box(*place, (turned if yaw is None else yaw) * one, *sizes)


@pytest.mark.slow
@pytest.mark.parametrize("model", ["logistic", "student", "mlp", "gp"])
def test_the_true_law_is_recovered(drive, model):
    from avrare_pem_training.pipeline import fit_model

    data = clean(drive(5000))
    lines = []
    fitted = fit_model(data, quick(model), {"model": model}, lines.append).model
    assert lines
    assert fitted.delivered is None
    law = fitted.clean.law(cars(RANGES), 0.0)
    np.testing.assert_allclose(law.detect.mean(axis=1), drive.detection(RANGES), atol=0.1)
    near = RANGES < 60  # too few detections beyond
    truth = drive.scales(RANGES[near]).T
    ratio = np.exp(np.log(law.scale[near]).mean(axis=1)) / truth
    assert (np.abs(np.log(ratio)) < np.log(1.3)).all()
    assert (np.abs(law.location[near].mean(axis=1)) < 0.3 * truth).all()
    assert 2.0 < min(law.dof) <= max(law.dof) < 5.0
    scores = evaluate(fitted, data)["delivered"].scores
    truth = drive.detection(data.test.range)
    entropy = -np.where(data.test.detected, np.log(truth), np.log(1 - truth)).mean()
    assert scores["detection_nll"] < entropy + 0.05
    assert scores["along_z4"] / scores["along_z4_own"] == pytest.approx(1.0, abs=0.5)


RISING = {20: 3.0, 40: 2.7, 80: 2.6, 160: 2.5, 320: 2.499, 640: 2.6}


@pytest.mark.parametrize(
    ("losses", "least_gain", "steps", "last"),
    [
        (RISING, np.inf, 20, 20),
        (RISING, 1e-2, 320, 320),  # the last one gained, though too little
        (RISING, 0.2, 80, 80),
        ({20: 3.0, 40: 2.5, 80: 2.6}, 1e-2, 40, 80),  # a longer one that is worse is not kept
    ],
)
def test_the_schedule_doubles_while_blocks_left_out_gain(losses, least_gain, steps, last, monkeypatch):
    from avrare_pem_training import fit_networks as module

    run = []

    class Trainer:
        def __init__(self, sample, recipe, blocks, doubled):
            self.steps = 20 * doubled
            self.loss = losses[self.steps]

        def run(self, rng):
            run.append((self.steps, rng.random()))

    monkeypatch.setattr(module, "_Trainer", Trainer)
    found = module._train(None, module.Recipe(least_gain=least_gain), [], seed=3)
    assert found.steps == steps
    assert [count for count, _ in run] == [20 * 2**i for i in range(len(run))]
    assert run[-1][0] == last
    assert len({number for _, number in run}) == 1  # every schedule begins anew, with the same seed


def test_tails_of_the_law_are_those_of_draws(drive):
    """Compare shares beyond z and beyond standard deviations with a sample of the law itself."""
    bound = np.repeat([5.0, 20.0, 60.0], 100_000)
    power = np.tile([1.0, 0.7, 1.3, 1.0], len(bound) // 4)
    z = student(2.5).draw_truncated(np.random.default_rng(0).standard_normal(len(bound)), bound, power)
    fit = ErrorFit(z, np.zeros_like(z), bound, 2.5, power)
    for seen, own in [*(fit.beyond(size) for size in (1.0, 4.0, 8.0)), fit.beyond_sd(4.0)]:
        assert seen == pytest.approx(own, rel=0.05)


def run(*words):
    return main([str(word) for word in words])


@pytest.mark.slow
def test_fit_writes_everything_and_repeats_itself(drive, tmp_path, capsys):
    write_table(tmp_path / "data.csv", drive(2000, artefact=True))
    for folder in ("a", "b"):
        code = run(
            "pem", "fit", tmp_path / "data.csv", "--model", "student", "--out", tmp_path / folder, "--name",
            "mine", "--licence", "CC0", "--source", "made up", "--seed", "3",
        )  # fmt: skip
        assert code == 0
    for ending in ("npz", "md", "json", "png"):
        assert (tmp_path / f"a/mine.{ending}").read_bytes() == (tmp_path / f"b/mine.{ending}").read_bytes()
    assert (tmp_path / "a/mine.png").read_bytes()[:4] == b"\x89PNG"
    card = (tmp_path / "a/mine.md").read_text()
    assert "| licence | CC0 |" in card
    assert "artefact of matching by axis-aligned boxes" in card
    scores = json.loads((tmp_path / "a/mine.json").read_text())
    assert f"{scores['delivered']['detection_nll']:.4f}" in card
    out = capsys.readouterr()
    assert "artefact of matching found" in out.err
    assert "labels, as delivered: detection NLL" in out.out
    assert load(tmp_path / "a/mine.npz").provenance["model"] == "student"
    assert run("pem", "score", tmp_path / "a/mine.npz", tmp_path / "data.csv", "--json") == 0
    assert json.loads(capsys.readouterr().out)["delivered"] == scores["delivered"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["fit", "none.csv", "--out", "x"], "none.csv: no such file"),
        (["fit", "none.csv", "--model", "forest", "--out", "x"], "invalid choice: 'forest'"),
        (["fit", "none.csv", "--name", "a/b", "--out", "x"], "is not a file name"),
        (["convert", "none.txt", "none.txt", "--out", "x"], "none.txt: no such file"),
        (["score", "pointpillarz", "none.csv"], "none.csv: no such file"),
        (["fit", "none.csv", "--name", "..", "--out", "x"], "is not a file name"),
        (["fit", "none.csv", "--name", "", "--out", "x"], "is not a file name"),
        (["fit", "none.csv", "--seed", "-1", "--out", "x"], "'-1' is not an integer from 0 to 999999999"),
        ([], "required"),
    ],
)
def test_wrong_arguments_give_no_traceback(words, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("pem", *words) == 4
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error
