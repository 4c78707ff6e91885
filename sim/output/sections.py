"""sections.csv: when the vehicle is under or beside what stands along its road."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from deepgnss.io.output import write_whole
from deepgnss.sim.motion.street import StreetPath
from deepgnss.sim.schema.build import Simulation
from deepgnss.sim.surroundings.schema import ROADSIDE

NAME: Final = "sections.csv"

_STEP_S: Final = 0.01


class Passage(NamedTuple):
    """A time between two ends of an obstacle, s from the start."""

    name: str
    from_s: float
    to_s: float


def passages(simulation: Simulation) -> Iterator[Passage]:
    """Every time the vehicle's reference point passes an obstacle, in the scenario's order.

    Ends are true to 10 ms; a closed road is passed once a lap. Names of obstacles of one kind
    are numbered as in ranges.csv; one that stands alone has no number.
    """
    path = simulation.scenario.vehicle.path
    if not isinstance(path, StreetPath):
        return
    t_s = np.arange(0.0, simulation.scenario.seconds + _STEP_S / 2.0, _STEP_S)
    along_m = path.road.wrapped(path.distance(t_s))
    obstacles = [one for one in simulation.config.surroundings if one.key in ROADSIDE]
    totals = Counter(one.key for one in obstacles)
    counts: Counter[str] = Counter()
    for one in obstacles:
        counts[one.key] += 1
        name = one.key if totals[one.key] == 1 else f"{one.key} {counts[one.key]}"
        start_m, end_m = getattr(one, one.key).reach()
        inside = np.flatnonzero((along_m >= start_m) & (along_m <= end_m))
        for part in np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1):
            if part.size:
                yield Passage(name, float(t_s[part[0]]), float(t_s[part[-1]]))


def write_sections(path: Path, simulation: Simulation) -> bool:
    """Write the passages by their GPST seconds of week; False where there is none."""
    start = simulation.scenario.start
    rows = [
        f"{one.name},{start.plus(one.from_s).tow_s:.2f},{start.plus(one.to_s).tow_s:.2f}\n"
        for one in sorted(passages(simulation), key=lambda one: one.from_s)
    ]
    if rows:
        write_whole(path, "name,from_tow_s,to_tow_s\n" + "".join(rows))
    return bool(rows)
