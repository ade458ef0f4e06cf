"""False detections: any model of this plugin with ghosts, boxes without a vehicle.

Each of K slots holds one ghost or none, a stationary chain: with probability s = exp(-dt / persistence) a
step leaves it as it was, else it is drawn anew, a ghost at a new place with probability q = rate / K. So the
number of ghosts in a frame is binomial with mean ``rate``, near Poisson for many slots, and one lasts
``persistence`` in the mean. Of a slot's standard normal numbers the first decides: a rank below (1 - s) q
makes a new ghost, one above 1 - (1 - s)(1 - q) empties the slot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.driving import Observation, Scene, World
from avrare.protocols import Bools, Floats
from avrare_gp_pem.config import Ghosts
from avrare_gp_pem.runtime import normal
from avrare_gp_pem.runtime.observation_model import weather_of
from avrare_gp_pem.runtime.persistence import check_ratio
from avrare_gp_pem.runtime.variant import MeasuredGhosts

NOISE_PER_GHOST = 5


@dataclass(frozen=True)
class GhostLaw:
    """Law of the false detections.

    Attributes:
        rate: Mean number in a frame.
        stay: Probability that a step leaves a slot as it was.
        slots: K.
        sd: Standard deviation of a ghost's place from step to step [m].
        speed_sd: Standard deviation of its observed speed [m/s].
        with_ego: Ghosts move with the ego; False: they stand on the road.
        ranges: (2, 2) least and greatest distance ahead and to the left [m], where ``points`` is empty.
        points: (P, 2) places ahead and to the left of the ego [m], equally likely.
        width: Standard deviation of the normal law around each of them [m].
        near: Share of the ghosts that appear around a vehicle.
        near_sd: (2,) standard deviations of their places, along and across it [m].
        weather: Power of the world's weather that multiplies the probability of a new one.
    """

    rate: float
    stay: float
    slots: int
    sd: float
    speed_sd: float
    with_ego: bool
    ranges: Floats
    points: Floats
    width: float
    near: float
    near_sd: Floats
    weather: float = 0.0

    @property
    def share(self) -> float:
        """Probability q that a slot holds a ghost."""
        return self.rate / self.slots

    def place(self, parts: Floats) -> tuple[Floats, Floats]:
        """Return distances ahead and to the left (N, K) of new ghosts, from noise (N, K, NOISE_PER_GHOST).

        They are counted from the ego, or from the vehicle that ``host`` names.
        """
        if not len(self.points):
            low, high = self.ranges.T
            place = low + (high - low) * normal.cdf(parts[..., 2:4])
        else:
            rank = normal.cdf(parts[..., 1])
            chosen = np.minimum((rank * len(self.points)).astype(np.int64), len(self.points) - 1)
            place = self.points[chosen] + self.width * parts[..., 2:4]
        if self.near:
            is_near = self._is_near(parts)[..., None]
            place = np.where(is_near, self.near_sd * parts[..., 2:4], place)
        return place[..., 0], place[..., 1]

    def host(self, parts: Floats, vehicles: int) -> NDArray[np.int64]:
        """Return (N, K) the vehicle around which each new ghost appears; -1: none."""
        if not (self.near and vehicles):
            return np.full(parts.shape[:2], -1, dtype=np.int64)
        rank = normal.cdf(parts[..., 1]) / self.near
        chosen = np.minimum((rank * vehicles).astype(np.int64), vehicles - 1)
        return np.where(self._is_near(parts), chosen, -1)

    def _is_near(self, parts: Floats) -> Bools:
        return np.asarray(normal.cdf(parts[..., 1]) < self.near)

    def same_places(self, other: GhostLaw) -> bool:
        """Return whether two laws are equal except for rate and persistence."""
        return all(
            np.array_equal(value, getattr(other, name))
            for name, value in vars(self).items()
            if name not in ("rate", "stay")
        )


@dataclass(frozen=True)
class GhostMemory:
    """Ghosts of N particles, and the memory of the model of the vehicles.

    Attributes:
        vehicles: Memory of the model of the vehicles, None where it has none.
        present: (N, K) which slots hold a ghost.
        forward: (N, K) distance ahead of the ego when the ghost appeared [m].
        left: (N, K) distance to the left [m].
        host: (N, K) before the first observation: the vehicle from which these are counted, -1 for the ego.
        x: (N, K) where it appeared, along the road [m].
        y: (N, K) across the road [m].
        begun: (N,) False before the first observation.
    """

    vehicles: Any
    present: Bools
    forward: Floats
    left: Floats
    x: Floats
    y: Floats
    begun: Bools
    host: NDArray[np.int64]


@dataclass(frozen=True)
class GhostPem:
    """Model with false detections, which last.

    Its observations have K slots after those of the vehicles. It has no ``log_prob``: a list of detections
    does not tell which of them are false.

    Attributes:
        vehicles: The model of the vehicles' detections.
        ghosts: Law of the false ones.
        count: Number of the vehicles.
    """

    vehicles: Any
    ghosts: GhostLaw
    count: int

    @property
    def ghost_slots(self) -> int:
        """Number of slots for false detections."""
        return self.ghosts.slots

    @property
    def noise_size(self) -> int:
        """Standard normal numbers per particle and step."""
        return int(self.vehicles.noise_size) + NOISE_PER_GHOST * self.ghosts.slots

    @property
    def noise_names(self) -> tuple[str, ...]:
        """Name of each noise number."""
        kinds = ("presence", "choice of place", "place along", "place across", "speed error")
        ghost_names = (f"{kind} of ghost {k}" for k in range(1, self.ghosts.slots + 1) for kind in kinds)
        return (*self.vehicles.noise_names, *ghost_names)

    @property
    def perfect_noise(self) -> tuple[float, ...]:
        """Noise without misses, errors and ghosts."""
        absent = 8.0  # a normal number at which no ghost exists
        return (*self.vehicles.perfect_noise, *((absent, 0.0, 0.0, 0.0, 0.0) * self.ghosts.slots))

    def start(self, noise: Floats) -> GhostMemory:
        """Return the memory at t = 0, in the stationary state, from noise (N, noise_size)."""
        first, parts = self._split(noise)
        forward, left = self.ghosts.place(parts)
        present = normal.cdf(parts[..., 0]) < self.ghosts.share
        nowhere = np.zeros_like(forward)
        vehicle_memory = self.vehicles.start(first) if self._lasts else None
        host, begun = self.ghosts.host(parts, self.count), np.zeros(len(noise), bool)
        return GhostMemory(vehicle_memory, present, forward, left, nowhere, nowhere, begun, host)

    def observe(self, world: World, noise: Floats) -> Observation:
        """Return one observation without a past, from noise (N, noise_size)."""
        first, parts = self._split(noise)
        memory = _anchor(self.start(noise), world)
        parts = _without_jitter(parts, np.ones_like(memory.present))
        return self._with_ghosts(self.vehicles.observe(world, first), world, parts, memory)

    def follow(self, world: World, noise: Floats, memory: GhostMemory) -> tuple[Observation, GhostMemory]:
        """Return the observation of the next step and the memory after it, from noise (N, noise_size)."""
        first, parts = self._split(noise)
        if self._lasts:
            observation, vehicle_memory = self.vehicles.follow(world, first, memory.vehicles)
        else:
            observation, vehicle_memory = self.vehicles.observe(world, first), None
        memory = _anchor(memory, world)
        new, gone = self._events(parts, self._share(world))
        forward, left, *at = _locate(world, *self.ghosts.place(parts), self.ghosts.host(parts, self.count))
        later = GhostMemory(
            vehicles=vehicle_memory,
            present=new | (memory.present & ~gone),
            forward=np.where(new, forward, memory.forward),
            left=np.where(new, left, memory.left),
            x=np.where(new, at[0], memory.x),
            y=np.where(new, at[1], memory.y),
            begun=memory.begun,
            host=memory.host,
        )
        return self._with_ghosts(observation, world, _without_jitter(parts, new), later), later

    def log_ratio(
        self, world: World, noise: Floats, memory: GhostMemory, other: GhostPem, other_memory: GhostMemory
    ) -> tuple[Floats, GhostMemory]:
        """Return (N,) log density ratio of a nearby model ``other``, see ``PersistentPem.log_ratio``.

        That of the ghosts is the ratio of the probabilities of the events in each slot. It is NaN where
        something can happen to a slot under ``other`` alone, as where its ghosts last and these do not.

        Raises:
            UsageError: The laws of the ghosts' places differ, or the model of the vehicles has no ratio.
        """
        if not self.ghosts.same_places(other.ghosts) or self.ghosts.weather:
            raise UsageError(
                "no density ratio is known for the places of ghosts",
                "of `ghosts` without weather, vary rate and persistence only",
            )
        check_ratio(self.vehicles, "log_ratio")
        first, parts = self._split(noise)
        ratio, vehicle_memory = self.vehicles.log_ratio(
            world, first, memory.vehicles, other.vehicles, other_memory.vehicles
        )
        new, gone = self._events(parts, self.ghosts.share)
        chances, other_chances = (_log_chances(law) for law in (self.ghosts, other.ghosts))
        with np.errstate(invalid="ignore"):  # what cannot happen under either law
            change = other_chances - chances
        if (change == np.inf).any():
            change = np.full_like(change, np.nan)
        happened = np.where(new, 0, np.where(gone, 1, 2))
        ratio = ratio + change[happened].sum(axis=1)
        q, other_q = self.ghosts.share, other.ghosts.share
        start = np.where(memory.present, math.log(other_q / q), math.log((1 - other_q) / (1 - q))).sum(axis=1)
        ratio = ratio + np.where(memory.begun, 0.0, start)
        return ratio, replace(other_memory, vehicles=vehicle_memory, begun=np.ones_like(memory.begun))

    @property
    def _lasts(self) -> bool:
        return hasattr(self.vehicles, "follow")

    def _split(self, noise: Floats) -> tuple[Floats, Floats]:
        size = int(self.vehicles.noise_size)
        return noise[:, :size], noise[:, size:].reshape(len(noise), self.ghosts.slots, NOISE_PER_GHOST)

    def _share(self, world: World) -> object:
        """Return the probability that a renewed slot holds a ghost, in the world's weather."""
        law, weather = self.ghosts, weather_of(world)
        if not law.weather or weather is None:
            return law.share
        return np.minimum(law.share * weather[:, None] ** law.weather, 1.0)

    def _events(self, parts: Floats, share: Any) -> tuple[Bools, Bools]:
        """Return which slots get a new ghost, and which are emptied."""
        renew = 1.0 - self.ghosts.stay
        new = normal.cdf(parts[..., 0]) < renew * share
        return new, ~new & (normal.cdf(-parts[..., 0]) <= renew * (1.0 - share))

    def _with_ghosts(
        self, seen: Observation, world: World, parts: Floats, memory: GhostMemory
    ) -> Observation:
        law, ego, present = self.ghosts, world.ego, memory.present
        x, y = memory.x, memory.y
        speed = np.zeros((len(x), 1))
        if law.with_ego:
            x, y = _on_road(world, memory.forward, memory.left)
            speed = ego.speed[:, None]
        cos, sin = np.cos(ego.heading)[:, None], np.sin(ego.heading)[:, None]
        ghosts = {
            "x": x + law.sd * parts[..., 2],
            "y": y + law.sd * parts[..., 3],
            "speed_x": speed * cos + law.speed_sd * parts[..., 4],
            "speed_y": np.broadcast_to(speed * sin, x.shape),
            "heading": np.broadcast_to(ego.heading[:, None], x.shape),
        }
        joined = {
            name: np.concatenate([getattr(seen, name), np.where(present, value, np.nan)], axis=1)
            for name, value in ghosts.items()
            if getattr(seen, name) is not None
        }
        return Observation(np.concatenate([seen.detected, present], axis=1), **joined)


def with_ghosts(model: object, ghosts: Ghosts | MeasuredGhosts | None, scene: Scene, speed_sd: float) -> Any:
    """Return ``model`` with false detections; ``model`` itself where there are none."""
    if ghosts is None:
        return model
    if isinstance(ghosts, MeasuredGhosts):
        options = Ghosts(rate=ghosts.rate, persistence=ghosts.persistence, slots=ghosts.slots)
        points, width = ghosts.points, float(ghosts.width)
    else:
        options, points, width = ghosts, np.zeros((0, 2)), 0.0
    seconds = options.persistence
    law = GhostLaw(
        rate=options.rate,
        stay=math.exp(-scene.dt / seconds) if seconds else 0.0,
        slots=options.slots,
        sd=options.sd,
        speed_sd=speed_sd,
        with_ego=options.motion == "ego",
        ranges=np.array([options.forward, options.left]),
        points=points,
        width=width,
        near=options.near if scene.names else 0.0,
        near_sd=np.array(options.near_sd),
        weather=options.weather,
    )
    return GhostPem(model, law, len(scene.names))


def _anchor(memory: GhostMemory, world: World) -> GhostMemory:
    """Place the ghosts of t = 0, whose world is not known there, in the first world."""
    begun, old = memory.begun[:, None], (memory.forward, memory.left, memory.x, memory.y)
    new = _locate(world, memory.forward, memory.left, memory.host)
    forward, left, x, y = (np.where(begun, *pair) for pair in zip(old, new, strict=True))
    return replace(memory, forward=forward, left=left, x=x, y=y, begun=np.ones_like(memory.begun))


def _locate(
    world: World, forward: Floats, left: Floats, host: NDArray[np.int64]
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return distances ahead and to the left of the ego, and places on the road, of new ghosts (N, K)."""
    x, y = _on_road(world, forward, left)
    near = host >= 0
    if not near.any():
        return forward, left, x, y
    ego, rows = world.ego, np.arange(len(host))[:, None]
    hx, hy, turn = (getattr(world.others, name)[rows, np.maximum(host, 0)] for name in ("x", "y", "heading"))
    x = np.where(near, hx + np.cos(turn) * forward - np.sin(turn) * left, x)
    y = np.where(near, hy + np.sin(turn) * forward + np.cos(turn) * left, y)
    dx, dy = x - ego.x[:, None], y - ego.y[:, None]
    cos, sin = np.cos(ego.heading)[:, None], np.sin(ego.heading)[:, None]
    return np.where(near, cos * dx + sin * dy, forward), np.where(near, cos * dy - sin * dx, left), x, y


def _without_jitter(parts: Floats, new: Bools) -> Floats:
    """Return noise that does not move the ``new`` ghosts: its numbers of the place have placed them."""
    place = np.arange(NOISE_PER_GHOST)
    return np.where(new[..., None] & ((place == 2) | (place == 3)), 0.0, parts)


def _on_road(world: World, forward: Floats, left: Floats) -> tuple[Floats, Floats]:
    ego = world.ego
    cos, sin = np.cos(ego.heading)[:, None], np.sin(ego.heading)[:, None]
    return ego.x[:, None] + cos * forward - sin * left, ego.y[:, None] + sin * forward + cos * left


def _log_chances(law: GhostLaw) -> Floats:
    """Return (3,) log probabilities of a new ghost, of none, and of no change."""
    renew = 1.0 - law.stay
    with np.errstate(divide="ignore"):
        return np.log([renew * law.share, renew * (1.0 - law.share), law.stay])
