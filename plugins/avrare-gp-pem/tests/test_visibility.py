"""Geometry of what the ego can see."""

import numpy as np
import pytest

from avrare_gp_pem.runtime.visibility import category, visibility


@pytest.mark.parametrize("distance", [5.0, 30.0, 300.0, 3000.0])
@pytest.mark.parametrize("bearing", [0.0, 1.0, np.pi, -2.5, np.pi / 2])
def test_a_single_vehicle_is_fully_visible_at_any_range(make, distance, bearing):
    world = make.world([[distance * np.cos(bearing), distance * np.sin(bearing), 0.4]])
    assert visibility(world, make.scene(1)) == 1.0


def test_behind_another_of_the_same_size_is_hidden(make):
    world = make.world([[10.0, 0.0, 0.0], [30.0, 0.0, 0.0]])
    np.testing.assert_array_equal(visibility(world, make.scene(2)), [[1.0, 0.0]])


def test_visibility_behind_the_ego_crosses_the_cut_of_the_angle(make):
    world = make.world([[-10.0, 0.0, np.pi], [-30.0, 0.0, 0.0], [-30.0, 20.0, 0.0]])
    np.testing.assert_array_equal(visibility(world, make.scene(3)), [[1.0, 0.0, 1.0]])


def test_one_half_hidden(make):
    # the near car's right edge is on the line of sight to the far car's centre
    world = make.world([[10.0, 0.9, 0.0], [60.0, 0.0, 0.0]])
    np.testing.assert_allclose(visibility(world, make.scene(2), rays=1000), [[1.0, 0.5]], atol=0.002)


def test_hidden_fraction_is_that_of_the_angle(make):
    # a wall from y = -5 to y = 5 at x = 20, and a near car whose silhouette is known
    scene = make.scene(2)
    scene.lengths[1], scene.widths[1] = 0.02, 10.0
    world = make.world([[10.0, 0.0, 0.0], [20.0, 0.0, 0.0]])
    hidden = np.arctan2(0.9, 10 - 2.25) / np.arctan2(5.0, 20 - 0.01)
    np.testing.assert_allclose(visibility(world, scene, rays=1000)[0, 1], 1 - hidden, atol=0.003)


def test_turning_the_world_changes_nothing(make):
    world = make.random(50, 4)
    seen = visibility(world, make.scene(4))
    assert 0 < seen.mean() < 1
    again = visibility(make.turned(world, 1.1, (100.0, -40.0)), make.scene(4))
    assert (np.abs(again - seen) <= 1 / 24 + 1e-12).all()  # a ray may graze a corner
    assert (again == seen).mean() > 0.95


def test_no_other_vehicle(make):
    assert visibility(make.world(np.empty((3, 0, 3))), make.scene(0)).shape == (3, 0)


def test_an_ego_inside_a_vehicle_sees_the_vehicle(make):
    assert visibility(make.world([[0.0, 0.0, 0.0]]), make.scene(1)) == 1.0


def test_categories_are_those_of_the_training_data():
    fractions = np.array([0.0, 0.39, 0.4, 0.59, 0.6, 0.79, 0.8, 1.0])
    np.testing.assert_array_equal(category(fractions), [1, 1, 2, 2, 3, 3, 4, 4])
