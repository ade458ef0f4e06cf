"""Roads and scenes, for docs/roads.md: files read, drivers, conversions, memory.

    OMP_NUM_THREADS=1 python benchmarks/scenes.py

Times are of one core's processor time. The files are those of ``tests/support/lanelet_scenes.py``, turned:
bends, opposing lanes, merges, lanes that widen, crossings.
"""

from __future__ import annotations

import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import numpy as np

from avrare.base.errors import AvrareError
from avrare.driving import Road, Scene, Vehicles
from avrare.driving.reference_line import CurvedLine, Piece
from avrare.results.recordings.drives import list_recordings, open_drives
from avrare.stack.builder import build_rule
from avrare_single_track.config import SingleTrackConfig
from avrare_single_track.simulator import build

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
FILES, PARTICLES, DRIVERS, POINTS = 100, 1000, 20, 200_000


def main() -> None:
    """Print a line for each measurement."""
    prompt, late = measure_drivers(0.0), measure_drivers(0.5)
    print(f"drivers: {prompt:.0f} vehicle-steps per ms, with reaction times {late:.0f}")
    into, out = measure_conversions()
    print(
        f"conversions: {into / 1e6:.2f} million points per s into the road's frame, {out / 1e6:.2f} out of it"
    )
    with tempfile.TemporaryDirectory() as folder:
        print(read_files(Path(folder)))
    print(f"R_I2, 100 vehicles, 500 samples: {measure_memory() / 1e6:.0f} MB beyond the recording")


def measure_drivers(reaction: float) -> float:
    """Return vehicle-steps per millisecond of 20 drivers on three lanes."""
    vehicles = [
        {
            "name": f"v{k}", "x": 28.0 * (k // 3) + 4.0 * (k % 3), "y": (-1.75, 1.75, 5.25)[k % 3],
            "speed": 20.0 + k % 5,
            "driver": {"desired_speed": 23.0 + k % 7, "acceleration_sd": 0.3, "reaction_time": reaction},
        }
        for k in range(DRIVERS)
    ]  # fmt: skip
    ego = {"x": -60.0, "y": 1.75, "speed": 20.0}
    simulator = build(SingleTrackConfig.model_validate({"ego": ego, "vehicles": vehicles}))
    noise = np.random.default_rng(0).standard_normal((PARTICLES, simulator.noise_size))
    world = simulator.reset(noise)
    memory = world.drivers
    assert memory is not None

    def step() -> None:
        simulator.reactive.step(memory, world.step, world.ego, world.others, noise)

    return PARTICLES * DRIVERS / best(step) / 1000.0


def best(call: Callable[[], object], times: int = 8) -> float:
    """Return the least processor time of several calls [s]."""
    call()
    found = []
    for _ in range(times):
        begin = time.process_time()
        call()
        found.append(time.process_time() - begin)
    return min(found)


def measure_conversions() -> tuple[float, float]:
    """Return points per second into the frame of a bent road, and out of it."""
    line = CurvedLine((Piece(60.0), Piece(100.0, 0.0, 0.004), Piece(200.0, 0.004, 0.004)))
    rng = np.random.default_rng(0)
    s, d = rng.uniform(0.0, 360.0, POINTS), rng.uniform(-20.0, 20.0, POINTS)
    x, y = line.to_plane(s, d)
    return POINTS / best(lambda: line.to_road(x, y), 2), POINTS / best(lambda: line.to_plane(s, d), 2)


def read_files(folder: Path) -> str:
    """Write 100 scenes, read them, and return how many, of how many egos, and the time."""
    kinds = import_module("lanelet_scenes").KINDS

    for k in range(FILES):
        kind = list(kinds)[k % len(kinds)]
        (folder / f"{kind}_{k:03}.xml").write_text(kinds[kind](0.3 * k), encoding="utf-8")
    begin, files, egos, refused = time.process_time(), 0, 0, 0
    for path in list_recordings(folder):
        drives = open_drives(str(path))
        files += 1
        for name in drives.names:
            try:
                drives.recording(name)
                egos += 1
            except AvrareError:
                refused += 1
    took = time.process_time() - begin
    return f"{files} of {FILES} CommonRoad files and {egos} egos read in {took:.1f} s, {refused} egos refused"


def measure_memory() -> float:
    """Return the bytes that R_I2 needs beyond its signals, at the most."""
    vehicles, samples = 100, 500
    sizes = np.full(vehicles, 4.5), np.full(vehicles, 1.8)
    road = Road((-1.75, 1.75, 5.25), 3.5)
    names = tuple(f"v{k}" for k in range(vehicles))
    rule = build_rule("R_I2", [], Scene(0.1, road, 4.5, 1.8, names, *sizes, np.ones(vehicles, dtype=bool)))
    rng = np.random.default_rng(0)
    lane, start = rng.integers(0, 3, vehicles).astype(np.float64), rng.uniform(0.0, 900.0, vehicles)
    speed = rng.uniform(20.0, 30.0, vehicles)
    tracemalloc.start()
    state = rule.start(1)
    for t in range(samples):
        zeros = np.zeros((1, vehicles))
        others = Vehicles(
            (start + 0.1 * t * speed)[None], (3.5 * lane - 1.75)[None], zeros, speed[None], zeros
        )
        own = {"x": 2.5 * t, "y": -1.75, "heading": 0.0, "speed": 25.0, "acceleration": 0.0}
        signals = {f"ego_{name}": np.array([value]) for name, value in own.items()}
        state, _ = rule.update(state, signals | {f"others_{name}": x for name, x in vars(others).items()})
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return float(peak)


if __name__ == "__main__":
    main()
