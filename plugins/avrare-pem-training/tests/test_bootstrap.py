"""Ensembles of refits: kept in the file, used by number, and as different as the data leave them."""

from dataclasses import replace

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare_gp_pem.config import GpPemConfig
from avrare_gp_pem.runtime.models import build_gp
from avrare_gp_pem.runtime.store import load, locate, save
from avrare_pem_training.cleaning import clean


def test_members_are_kept_in_the_file(tmp_path, make, pointpillars):
    other = load(locate("measured"))
    path = tmp_path / "model.npz"
    save(path, replace(pointpillars, ensemble=(other, pointpillars)))
    again = load(path)
    assert len(again.ensemble) == 2
    scene, world = make.scene(2), make.random(4, 2)
    for number, truth in ((0, pointpillars), (1, other), (2, pointpillars)):
        built = build_gp(GpPemConfig(model=str(path), member=number), scene)
        named = "measured" if truth is other else "pointpillars"
        same = build_gp(GpPemConfig(model=named), scene)
        assert np.array_equal(built.law(world).detect, same.law(world).detect)
    with pytest.raises(UsageError, match="no member 3: it has 2"):
        build_gp(GpPemConfig(model=str(path), member=3), scene)
    with pytest.raises(UsageError, match="no member 1: it has none"):
        build_gp(GpPemConfig(model="measured", member=1), scene)
    save(tmp_path / "alone.npz", pointpillars)
    assert load(tmp_path / "alone.npz").ensemble == ()


def test_refits_search_for_no_schedule_of_their_own(drive, monkeypatch):
    from avrare_pem_training import pipeline
    from avrare_pem_training.bootstrap import fit_ensemble

    recipes = []

    def fit_networks(sample, recipe, seed, report):
        recipes.append(recipe)
        return train(sample, recipe, seed, report)

    train = pipeline.fit_networks
    monkeypatch.setattr(pipeline, "fit_networks", fit_networks)
    recipe = replace(pipeline.RECIPES["logistic"][0], members=3, epochs=1, least_steps=12, least_gain=0.05)
    data, lines = clean(drive(800)), []
    fit = pipeline.fit_model(data, pipeline.FitPlan("logistic", recipe=recipe), {}, lines.append)
    fit_ensemble(fit, data, 2, lines.append)
    steps = int(lines[0].rpartition(" ")[2])
    assert steps > 12  # the first schedule was too short
    assert recipes[0] == recipe
    longer = replace(recipe, epochs=steps // 12, least_steps=steps, least_gain=np.inf)
    assert recipes[1] == recipes[2] == longer


@pytest.mark.slow
def test_refits_scatter_as_the_data_leave_them(drive):
    from avrare_pem_training.bootstrap import fit_ensemble
    from avrare_pem_training.pipeline import RECIPES, FitPlan, fit_model

    recipe = replace(RECIPES["logistic"][0], members=3, epochs=8, least_steps=250, least_gain=np.inf)
    spreads = []
    for rows in (800, 8000):
        data, plan = clean(drive(rows)), FitPlan("logistic", recipe=recipe)
        model = fit_ensemble(fit_model(data, plan, {}, lambda line: None), data, 6, lambda line: None)
        assert len(model.ensemble) == 6
        bases = (one.clean.base_scale for one in (model, *model.ensemble))
        own, *others = (np.log(base[:, 0] + 30 * base[:, 1]) for base in bases)
        scales = np.array(others)
        assert np.abs(scales.mean(axis=0) - own).max() < 4 * scales.std(axis=0).max()
        spreads.append(scales.std(axis=0).mean())
    assert 1.5 < spreads[0] / spreads[1] < 7.0
