"""Batched linear assignment: the Hungarian method by shortest augmenting paths, for N problems at once.

Kuhn (1955), with the potentials and paths of Jonker and Volgenant (1987). Every operation is elementwise over
the problems, so that none depends on its neighbours in the batch.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from avrare.protocols import Bools, Floats

Indices = NDArray[np.intp]


def assign(gain: Floats) -> Indices:
    """Return the assignment with the largest total gain, where nothing need be assigned.

    Args:
        gain: (N, T, S) of giving item s to t; 0 or less, -inf and NaN: never.

    Returns:
        (N, T) items, -1 where t gets none; no item is given twice.
    """
    if not gain.shape[2]:
        return np.full(gain.shape[:2], -1, np.intp)
    useful = gain > 0.0
    assignment = np.where(useful.any(axis=2), useful.argmax(axis=2), -1)
    contested = (useful.sum(axis=1) > 1).any(axis=1) | (useful.sum(axis=2) > 1).any(axis=1)
    rows = np.flatnonzero(contested)
    if len(rows):
        assignment[rows] = _solve(np.where(useful[rows], -gain[rows], np.inf))
    return assignment


def _solve(cost: Floats) -> Indices:
    count, tracks, items = cost.shape
    unassigned_cost = np.where(
        np.eye(tracks, dtype=bool), 0.0, np.inf
    )  # a column for each t that gets no item
    cost = np.concatenate([cost, np.broadcast_to(unassigned_cost, (count, tracks, tracks))], axis=2)
    solver = _Solver(cost)
    for track in range(tracks):
        solver.add(track)
    owner = solver.owner[:, :items]
    assignment = np.full((count, tracks), -1, np.intp)
    rows, chosen_item = np.nonzero(owner >= 0)
    assignment[rows, owner[rows, chosen_item]] = chosen_item
    return assignment


class _Solver:
    """Assignments that grow by one row of the cost matrices (N, T, M) at a time, always optimal.

    Column M stands for the row that is being added.
    """

    def __init__(self, cost: Floats) -> None:
        count, tracks, columns = cost.shape
        self.cost = cost
        self.row_potential = np.zeros((count, tracks))
        self.potential = np.zeros((count, columns + 1))
        self.owner = np.full((count, columns + 1), -1, np.intp)

    def add(self, track: int) -> None:
        """Assign one more row, along the shortest augmenting path."""
        count, _, columns = self.cost.shape
        problems = np.arange(count)
        self.owner[:, columns] = track
        at = np.full(count, columns, np.intp)
        before = np.full((count, columns), columns, np.intp)
        least = np.full((count, columns), np.inf)
        used = np.zeros((count, columns + 1), bool)
        searching = problems
        while len(searching):
            at[searching] = self._reach(searching, at[searching], before, least, used)
            searching = searching[self.owner[searching, at[searching]] >= 0]
        changing = problems
        while len(changing):
            previous = before[changing, at[changing]]
            self.owner[changing, at[changing]] = self.owner[changing, previous]
            at[changing] = previous
            changing = changing[previous != columns]

    def _reach(self, rows: Indices, at: Indices, before: Indices, least: Floats, used: Bools) -> Indices:
        """Return the nearest column that is not on the tree, in these problems."""
        used[rows, at] = True
        owner = self.owner[rows, at]
        reduced = self.cost[rows, owner] - self.row_potential[rows, owner, None] - self.potential[rows, :-1]
        free = ~used[rows, :-1]
        nearer = free & (reduced < least[rows])
        least[rows] = np.where(nearer, reduced, least[rows])
        before[rows] = np.where(nearer, at[:, None], before[rows])
        distance = np.where(free, least[rows], np.inf)
        nearest: Indices = distance.argmin(axis=1)
        step = distance[np.arange(len(rows)), nearest][:, None]
        on_tree = used[rows]
        problem, column = np.nonzero(on_tree)
        self.row_potential[rows[problem], self.owner[rows[problem], column]] += step[problem, 0]
        self.potential[rows] -= np.where(on_tree, step, 0.0)
        least[rows] = np.where(free, least[rows] - step, least[rows])
        return nearest
