"""What the ego can see, what the model reads of a world, and where its errors go."""

import numpy as np
import pytest

from avrare_gp_pem.runtime.features import NAMES, Box, box_of, features
from avrare_gp_pem.runtime.observation_model import ObservationLaw
from avrare_gp_pem.runtime.visibility import category, relative, visibility
from avrare_pem_training.table import BOX, ERRORS, errors_in, make_table


def read(world, scene):
    return box_of(relative(world), scene.lengths, scene.widths, 1.7, np.full(world.others.x.shape, 4.0))


def test_ego_heading_counts(make):
    # ego looks along +y, the car is 20 m ahead of it and points to the ego's left
    box = read(make.world([[0.0, 20.0, np.pi]], ego=(0.0, 0.0, np.pi / 2)), make.scene(1))
    values = np.array([box.right[0, 0], box.forward[0, 0], box.yaw[0, 0]])
    np.testing.assert_allclose(values, [0.0, 20.0, np.pi], atol=1e-12)


def test_turning_the_world_changes_no_feature(make):
    world, scene = make.random(40, 3), make.scene(3)
    before = features(read(world, scene))
    after = features(read(make.turned(world, 2.2, (7.0, 9.0)), scene))
    np.testing.assert_allclose(after, before, atol=1e-9)


def test_feature_values():
    one = np.array(1.0)
    box = Box(3 * one, 4 * one, 0.2 * one, 4.5 * one, 1.8 * one, 1.7 * one, 2 * one)
    values = dict(zip(NAMES, features(box), strict=True))
    bearing = np.arctan2(4, 3)
    assert values["range"] == pytest.approx(5.0)
    assert values["cos_aspect"] == pytest.approx(np.cos(0.2 - bearing))
    assert values["sin_aspect"] == pytest.approx(np.sin(0.2 - bearing))
    assert values["cos_bearing"] == pytest.approx(0.6)
    assert values["edge"] == pytest.approx(np.tanh((4 - 51.2) / 3))
    assert (values["length"], values["visibility"]) == (4.5, 2.0)


def law_of(location, world):
    shape = world.others.x.shape
    located = np.broadcast_to(np.asarray(location, float), (*shape, 2))
    scale = np.full((*shape, 2), 1e-9)
    return ObservationLaw(np.ones(shape), np.zeros(shape), located, scale, (3.0, 3.0), 6.0, 0.0)


@pytest.mark.parametrize("angle", [0.0, 0.7, np.pi / 2, -2.0])
def test_observed_is_truth_minus_error_in_the_frame_of_the_vehicle(make, angle):
    world = make.turned(make.world([[20.0, 0.0, 0.0]]), angle)
    observation = law_of((0.5, 0.2), world).draw(world, np.zeros((1, 4)))
    error = world.others.x[0, 0] - observation.x[0, 0], world.others.y[0, 0] - observation.y[0, 0]
    ahead, left = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    np.testing.assert_allclose(error, 0.5 * ahead + 0.2 * left, atol=1e-6)


def test_error_of_the_data_frame_comes_back(make):
    # the error of a label, taken to the vehicle's axes and back through a world, is the label's
    yaw, error = 2.0, np.array([0.3, -0.4])  # error in right, forward
    row = (5.0, 20.0, yaw, 4.5, 1.8, 1.7, 4.0, 1.0, *error, 0.0)
    names = (*BOX, "detected", *ERRORS)
    table = make_table({name: np.array([value]) for name, value in zip(names, row, strict=True)})
    world = make.world([[20.0, -5.0, yaw - np.pi / 2]])  # forward = x, right = -y
    observation = law_of(errors_in("vehicle", table)[0], world).draw(world, np.zeros((1, 4)))
    right = -(world.others.y - observation.y)[0, 0]
    forward = (world.others.x - observation.x)[0, 0]
    np.testing.assert_allclose([right, forward], error, atol=1e-6)


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
