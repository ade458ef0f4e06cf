"""Systems whose signals are their state: each test says only how theirs moves."""

import numpy as np

from avrare.protocols import System
from avrare.testing.static_problems import Static as StaticProblem
from avrare.testing.static_problems import row_sum


class Still(System):
    """System that stays at its first number."""

    noise_size = 1

    def initial(self, noise):
        return {"x": noise[:, 0]}

    def step(self, state, noise):
        return state

    def signals(self, state):
        return state


class Sum(Still):
    """System that adds its first number at each step."""

    def step(self, state, noise):
        return {"x": state["x"] + noise[:, 0]}


class Static(Still):
    """System that stays at a function of its first numbers."""

    def __init__(self, noise_size, signal):
        self.noise_size, self.signal = noise_size, signal

    def initial(self, noise):
        return {"x": self.signal(noise)}


class Largest(Still):
    """System whose signal is the largest number of its steps so far."""

    def initial(self, noise):
        return {"x": np.zeros(len(noise))}

    def step(self, state, noise):
        return {"x": np.maximum(state["x"], noise[:, 0])}


class LogProduct(StaticProblem):
    """The logarithm of the product of lognormals: family i where it is linear."""

    def signals(self, state):
        return {"log_product": row_sum(0.5 * state.values)}


class Total(StaticProblem):
    """The sum of the numbers of the start."""

    def signals(self, state):
        return {"total": row_sum(state.values)}
