"""Chunks on workers that may die."""

import numpy as np
import pytest

from avrare.rollout.executors.in_flight import MOST_LOSSES, Window, WorkerDied, WorkerLost
from avrare.rollout.request import Request


def chunk(number):
    one = np.array([number])
    return Request(one * 0, one * 0, one, one * 0 - 1)


class Hand:
    def __init__(self, answer, lost):
        self.answer, self.lost = answer, lost

    def done(self):
        return True

    def result(self):
        if self.lost:
            raise WorkerLost
        return self.answer


class Crew:
    """Answers with the number of the chunk; ``deaths`` says how often a chunk takes everybody with it."""

    def __init__(self, deaths):
        self.deaths, self.submitted, self.hands, self.restarts = dict(deaths), [], [], 0

    def submit(self, chunk):
        number = int(chunk.particle[0])
        self.submitted.append(number)
        hand = Hand(number, lost=False)
        self.hands.append(hand)
        if self.deaths.get(number, 0):
            self.deaths[number] -= 1
            for other in self.hands[-3:]:
                other.lost = True
        return hand

    def replace_lost(self):
        self.hands = []


def outcomes(window, many=10):
    return list(window.map(chunk(number) for number in range(many)))


@pytest.mark.parametrize("deaths", [{}, {0: 1}, {4: 2}, {9: 2}, {2: 1, 3: 1, 7: 2}, {1: 2, 2: 2}])
def test_all_outcomes_come_in_order(deaths):
    window = Window(Crew(deaths), 3)
    assert outcomes(window) == list(range(10))
    assert (window.crew.restarts > 0) == bool(deaths)
    assert not window.busy


@pytest.mark.parametrize("culprit", [0, 5, 9])
def test_a_chunk_that_always_kills_its_worker_is_named(culprit):
    crew = Crew({culprit: 99})
    with pytest.raises(WorkerDied, match=f"{MOST_LOSSES} times on .* particle {culprit}\n"):
        outcomes(Window(crew, 3))
    assert crew.submitted.count(culprit) == MOST_LOSSES


def test_no_more_chunks_are_taken_than_there_is_room_for():
    taken = []

    def source():
        for number in range(9):
            taken.append(number)
            yield chunk(number)

    answers = Window(Crew({}), 3).map(source())
    for number in range(6):
        assert next(answers) == number
        assert len(taken) == number + 3


def test_an_error_of_a_chunk_comes_in_order():
    class Wrong(Crew):
        def submit(self, chunk):
            hand = super().submit(chunk)
            if hand.answer == 4:
                hand.result = lambda: 1 / 0
            return hand

    answers = Window(Wrong({3: 1}), 3).map(chunk(number) for number in range(9))
    assert [next(answers) for _ in range(4)] == [0, 1, 2, 3]
    with pytest.raises(ZeroDivisionError):
        next(answers)


def test_a_crew_that_loses_every_worker_is_an_error():
    class Nobody(Crew):
        def submit(self, chunk):
            raise WorkerLost

    with pytest.raises(WorkerDied, match="particle 0"):
        outcomes(Window(Nobody({}), 3))
