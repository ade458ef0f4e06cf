"""Tracks in a log, and how long errors last."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from avrare.cli.main import main
from avrare.driving import Vehicles, World
from avrare_gp_pem.config import Persistence
from avrare_gp_pem.runtime.features import Box
from avrare_gp_pem.runtime.observation_model import ObservationLaw
from avrare_gp_pem.runtime.persistence import with_persistence
from avrare_gp_pem.runtime.variant import MeasuredPersistence
from avrare_pem_training.persistence import bivariate_normal, fit_persistence, track_pairs
from avrare_pem_training.table import make_table, read_table, write_table
from avrare_pem_training.tracks import link_by_size
from perception_scenes import make_scene


def table(right, forward, length, yaw=0.3):
    one = np.ones(len(right))
    columns = {"right": right, "forward": forward, "length": length, "yaw": yaw * one, "width": 1.8 * one}
    columns |= {"detected": one, "error_right": 0 * one, "error_forward": 0 * one}
    return make_table({name: np.asarray(values, float) for name, values in columns.items()})


def test_boxes_of_one_size_are_one_track_until_they_jump():
    rows = table([0, 5, 1, 6, 2, 2, 90], [10, 20, 11, 21, 12, 12, 12], [4.1, 4.2, 4.1, 4.2, 4.1, 4.1, 4.1])
    linked = link_by_size(rows, 0.5)
    track = linked.track
    assert track[0] == track[2] == track[4]
    assert track[1] == track[3] != track[0]
    assert len({track[4], track[5], track[6], track[1]}) == 4  # the same box again, and a jump
    np.testing.assert_array_equal(linked.time, [0, 0, 0.5, 0.5, 1.0, 0, 0])


def test_a_track_ends_where_its_size_is_not_seen_for_long():
    n = 100
    sizes = 4 + 0.01 * np.arange(n)
    sizes[-1] = sizes[0]
    assert link_by_size(table(np.zeros(n), 10 + 0.01 * np.arange(n), sizes), 0.5).time.max() == 0


def test_tracks_survive_a_file_and_may_be_missing(tmp_path):
    rows = link_by_size(table([0, 1, 2], [10, 11, 12], [4.1] * 3), 0.5)
    write_table(tmp_path / "a.csv", rows)
    again = read_table(tmp_path / "a.csv")
    np.testing.assert_array_equal(again.track, rows.track)
    np.testing.assert_array_equal(again.time, rows.time)
    write_table(tmp_path / "b.csv", replace(rows, track=np.full(3, np.nan)))
    assert "track" not in (tmp_path / "b.csv").read_text()
    assert np.isnan(read_table(tmp_path / "b.csv").time).all()


def test_convert_with_a_period_links(tmp_path, capsys):
    (tmp_path / "in.txt").write_text("1 20 0.5 4.5 1.8 1.6 3\n1 21 0.5 4.5 1.8 1.6 3\n")
    (tmp_path / "out.txt").write_text("1 0.1 0.2 0.3\n0 0 0 0\n")
    words = [str(tmp_path / name) for name in ("in.txt", "out.txt")]
    assert main(["pem", "convert", *words, "--out", str(tmp_path / "made"), "--period", "0.1"]) == 0
    np.testing.assert_array_equal(read_table(tmp_path / "made" / "in.csv").time, [0, 0.1])
    assert main(["pem", "convert", *words, "--out", str(tmp_path / "made"), "--period", "-1"]) == 4
    assert "is not a time" in capsys.readouterr().err


def test_pairs_are_all_within_a_track_and_not_too_far_apart():
    rows = table([0] * 6, [10] * 6, [4] * 6)
    rows = replace(rows, track=np.array([1, 2, 1, 1, np.nan, 2]), time=np.array([0, 0, 2.0, 9.0, 0, 3.0]))
    pairs = track_pairs(rows)
    found = set(zip(pairs.first.tolist(), pairs.second.tolist(), pairs.seconds.tolist(), strict=True))
    assert found == {(0, 2, 2.0), (1, 5, 3.0)}
    assert len(track_pairs(table([0], [10], [4])).first) == 0


@pytest.mark.parametrize("correlation", [-0.7, 0.0, 0.3, 0.9, 0.99])
def test_bivariate_normal_probability(correlation):
    points = np.array([[0.0, 0.0], [1.2, -0.4], [-2.0, -1.5], [2.5, 3.0]])
    exact = multivariate_normal(cov=[[1, correlation], [correlation, 1]]).cdf(points)
    ours = bivariate_normal(*points.T, np.full(len(points), correlation))
    np.testing.assert_allclose(ours, exact, atol=1e-4)


class Known:
    """Variant whose law is the same for all."""

    frame = "vehicle"

    def law(self, rows, speed_sd):
        one = np.ones(len(rows.right))
        two = np.stack([one, one], axis=1)
        tails = ((3.0, 2.5), 8.0, speed_sd)
        return ObservationLaw(0.8 * one, 0.2 * one, 0 * two, two * [0.2, 0.1], *tails)


def persistent_log(tracks, frames, persistence, seed=0):
    """Return rows of vehicles that stand still, drawn with the noise of the runtime's own persistence."""
    zero, one = np.zeros(tracks), np.ones((tracks, 1))
    scene = replace(make_scene(1), dt=0.5)
    world = World(zero.astype(int), Vehicles(*[zero] * 5), Vehicles(20 * one, *[0 * one] * 4), zero)

    class Pem:
        noise_size = 4

        def observe(self, world, noise):
            law = Known().law(table(zero, zero, zero), 0.0)
            columns = ("detect", "miss", "location", "scale")
            boxed = replace(law, **{name: getattr(law, name)[:, None] for name in columns})
            return boxed.draw(world, noise)

    model = with_persistence(Pem(), Persistence(**persistence), scene)
    rng = np.random.default_rng(seed)
    memory, parts = model.start(rng.standard_normal((tracks, 4))), []
    for frame in range(frames):
        seen, memory = model.follow(world, rng.standard_normal((tracks, 4)), memory)
        box = Box(*(np.full(tracks, value) for value in (0.0, 20.0, 0.0, 4.5, 1.8, 1.7, 4.0)))
        columns = vars(box) | {
            "detected": seen.detected[:, 0].astype(float),
            "error_right": 20 - seen.x[:, 0],
            "error_forward": -seen.y[:, 0],
            "track": np.arange(tracks, dtype=float),
            "time": np.full(tracks, 0.5 * frame),
        }
        parts.append(columns)
    return make_table({name: np.concatenate([part[name] for part in parts]) for name in parts[0]})


def test_the_persistence_of_a_log_is_found():
    truth = {"detection": 0.9, "detection_lasting": 0.3, "position": 0.6, "position_lasting": 0.15}
    found = fit_persistence(Known(), persistent_log(1500, 9, truth))
    assert isinstance(found, MeasuredPersistence)
    np.testing.assert_allclose(found.detection, [0.9, 0.3], rtol=0.25)
    np.testing.assert_allclose(found.position, [0.6, 0.15], rtol=0.25)
