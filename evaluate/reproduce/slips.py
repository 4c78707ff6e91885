"""SLIP-95, SLIP-ATT: cycle slips between two antennas of a car, S 1.3 and 2.

Observations are made from true ranges of either antenna at the instants its own receiver's clock
has truly reached, with noise, multipath, atmosphere and clocks that jump by a millisecond; the
attitude is that of our loose coupling of the same drive's inertial log.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from deepgnss.core.attitude import (
    euler_rad,
    quaternion_from_euler,
    quaternion_from_rotation_vector,
    quaternion_product,
)
from deepgnss.core.bands import band_wavelength_m
from deepgnss.core.records import FloatArray
from deepgnss.deep.slips import BoolArray, sure
from deepgnss.evaluate.antenna_pair import AntennaPair, antenna_pair
from deepgnss.evaluate.reproduce.table import Figure, percent
from deepgnss.evaluate.simulated_pair import read_pair, simulate_pair
from deepgnss.evaluate.slip_trials import (
    BY_CODE,
    BY_RESIDUAL,
    OURS,
    Inserted,
    Score,
    method_scores,
    random_slips,
    with_slips,
)
from deepgnss.evaluate.slips import (
    Expected,
    Slips,
    find_slips,
)
from deepgnss.io.rinex_obs_reader import read_obs
from deepgnss.io.truth import Trajectory
from deepgnss.sim.motion.vehicle import geographic
from deepgnss.sim.output.columns import time_columns
from deepgnss.sim.output.pair import write_pair
from deepgnss.sim.scenario import Scenario
from deepgnss.sim.schema import PUBLISHED, ScenarioConfig, build, load_scenario
from deepgnss.theory.slips import (
    attitude_limit_rad,
    rounding_limit_rad,
    share_right,
    value_sigma_cycles,
)

SCENARIO: Final = PUBLISHED + "slips"
L1_M: Final = band_wavelength_m("G", "1")
PUBLISHED_DEG: Final = 1.375

_WANTED: Final = 1002  # slips of all seeds together
_QUICK_S: Final = 60.0


# --- SLIP-95 -------------------------------------------------------------------------------------


def slipped_drive(seed: int, count: int, *settings: str) -> tuple[Inserted, Slips]:
    """A drive with slips put in from the first epoch of the INS on, and what was found."""
    config = load_scenario(SCENARIO, (*settings, f"seed={seed}"))
    with TemporaryDirectory(prefix="deepgnss-") as folder:
        pair = read_pair(simulate_pair(config, Path(folder)))
    slips = random_slips(pair, count, np.random.default_rng(seed), hard=True)
    return slips, find_slips(with_slips(pair, slips), Expected())


def measure_slips(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """Random slips, hard ones among them, on both frequencies; quick: a minute."""
    settings = (f"seconds={_QUICK_S:g}",) if quick else ()
    count = -(-_WANTED // len(seeds)) if not quick else 100
    runs = [slipped_drive(seed, count, *settings) for seed in seeds]
    scores = [method_scores(found, slips) for slips, found in runs]
    ours, code, residual = (
        _sum([one[name] for one in scores]) for name in (OURS, BY_CODE, BY_RESIDUAL)
    )
    largest_m = max(float(np.nanmax(np.abs(f.between.check_m[sure(f.between)]))) for _, f in runs)
    shared = [
        (
            int(np.count_nonzero((s.between != 0.0) & f.shares.known & _shared_right(s, f))),
            int(np.count_nonzero((s.between != 0.0) & f.shares.known)),
        )
        for s, f in runs
    ]
    right, told = (sum(column) for column in zip(*shared, strict=True))
    return [
        Figure(
            "slips found, with their cycles",
            percent(ours.found, ours.inserted),
            ours.found == ours.inserted,
        ),
        Figure("false", f"{ours.false} of {ours.phases - ours.inserted} phases", ours.false == 0),
        Figure("largest check value", f"{1e3 * largest_m:.1f} mm (published 6)", None),
        Figure(
            "of these, antenna told and right",
            f"{percent(right, told)}, {ours.inserted - told} not told",
            None,
        ),
        Figure(
            "beside: pseudorange and phase",
            f"{percent(code.found, code.inserted)}, {code.false} false",
            None,
        ),
        Figure(
            "beside: ionospheric residual, 0.1 m (either frequency)",
            f"{percent(residual.found, residual.inserted)}, {residual.false} false",
            None,
        ),
    ]


def _shared_right(slips: Inserted, found: Slips) -> BoolArray:
    right = (found.shares.first == slips.first) & (found.shares.second == slips.second)
    return np.asarray(right)


def _sum(scores: Sequence[Score]) -> Score:
    return Score(*(sum(column) for column in zip(*scores, strict=True)))


# --- SLIP-ATT ------------------------------------------------------------------------------------


def turned_pair(scenario: Scenario, turns_rad: FloatArray) -> AntennaPair:
    """Both antennas' phases over a prediction whose attitude is wrong by given turns (n, 3), NED.

    One turn for each second from one before the scenario's start on.
    """
    t_s = np.arange(-1.0, len(turns_rad) - 1.0)
    seen = geographic(scenario.vehicle.pose(t_s))
    q_nb = quaternion_product(
        quaternion_from_rotation_vector(turns_rad), quaternion_from_euler(seen.euler_rad)
    )
    weeks, tow_s = time_columns(scenario.start, t_s)
    lever_b_m = [antenna.lever_b_m for antenna in scenario.antennas]
    r_e_m = scenario.vehicle.point(t_s, lever_b_m[0]).r_m
    way = Trajectory(np.array(weeks, np.int64), tow_s, r_e_m, None, euler_rad(q_nb))
    places = tuple(way.of_point(np.subtract(lever, lever_b_m[0]).tolist()) for lever in lever_b_m)
    with TemporaryDirectory(prefix="deepgnss-") as folder:
        files = [read_obs(path) for path in write_pair(Path(folder), scenario)]
    return antenna_pair(files[0], files[1], (places[0], places[1]), scenario.nav)


def triple_differences(pair: AntennaPair) -> tuple[FloatArray, FloatArray, FloatArray]:
    """S's test between all pairs of satellites on their first signal, epoch by epoch.

    Returns: values in cycles (n − 1, p); baselines (n − 1, 1, 3) and uᵢ − uⱼ (n − 1, p, 3).
    """
    first = [k for k, signal in enumerate(pair.signals) if signal.band == "1"]
    single = (pair.second.phase_m - pair.first.phase_m)[:, first]
    one, two = np.triu_indices(len(first), 1)
    values = np.diff(single[:, one] - single[:, two], axis=0) / L1_M
    unit = pair.first.unit_e[1:, first]
    return values, pair.baseline_e_m[1:, np.newaxis], unit[:, one] - unit[:, two]


def measure_attitude(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """S's limit for 1 m by theory; turns between two epochs, fixed and random, by Monte Carlo."""
    limit_rad = attitude_limit_rad(1.0, L1_M)
    limit_deg = math.degrees(limit_rad)
    figures = [
        Figure(
            "S(1.3) for 1 m, L1: λ/8",
            f"{limit_deg:.3f}° (printed {PUBLISHED_DEG}°: 0.02379 rad rounded to 0.024)",
            abs(limit_deg / PUBLISHED_DEG - 1.0) < 0.01,
        )
    ]
    config = load_scenario(SCENARIO, ("seconds=100" if quick else "seconds=400", *_ONE_METRE))
    for turn_rad, what in (
        (limit_rad, "S"),
        (rounding_limit_rad(1.0, L1_M), "rounding"),
    ):
        figures.append(_fixed(config, seeds, turn_rad, what))
    for factor in (1.0, 2.0, 4.0):
        figures.append(_random(config, seeds, factor * limit_rad))
    return figures


_ONE_METRE: Final = (
    "antennas=[{name: a, lever_arm: [0.5, 0, -1.2]}, {name: b, lever_arm: [-0.5, 0, -1.2]}]",
)
_DRAWS: Final = 200  # turns by theory at each epoch, for the spread of shares
_NOISE_M: Final = 0.0015  # of one phase: thermal 0.5 to 1.6 mm, multipath changes by 0.8 mm


def _seeded(config: ScenarioConfig, seed: int) -> Scenario:
    return build(config.model_copy(update={"seed": seed})).scenario


def _fixed(config: ScenarioConfig, seeds: Sequence[int], turn_rad: float, what: str) -> Figure:
    """A turn of one size about any axis at every other epoch, a slip of one cycle in each."""
    found = trials = 0
    largest = 0.0
    for seed in seeds:
        scenario, rng = _seeded(config, seed), np.random.default_rng(seed)
        axis = rng.standard_normal((int(scenario.seconds) + 3, 3))
        turns = turn_rad * axis / np.linalg.norm(axis, axis=1, keepdims=True)
        turns[::2] = 0.0
        values, _, _ = triple_differences(turned_pair(scenario, turns))
        values = values[np.isfinite(values)]
        found += int(np.count_nonzero(np.round(values + 1.0) == 1.0))
        trials += values.size
        largest = max(largest, float(np.abs(values).max()))
    bound = 2.0 * turn_rad / L1_M
    noise = 6.0 * math.sqrt(8.0) * _NOISE_M / L1_M
    return Figure(
        f"turn of {math.degrees(turn_rad):.3f}°, limit of {what}: 1 cycle found",
        f"{percent(found, trials)}, largest error {largest:.3f} of at most {bound:.2f} cycle",
        largest <= bound + noise and (found == trials or bound + noise > 0.5),
    )


def _random(config: ScenarioConfig, seeds: Sequence[int], sigma_rad: float) -> Figure:
    """Turns of given 1σ by axis: the share found against theory, within 3 of the mean's own σ.

    That σ is theory's, too: few turns hold all failures, and a sample without them would hide it.
    """
    shares: list[float] = []
    expected: list[float] = []
    spreads: list[float] = []
    for seed in seeds:
        scenario, rng = _seeded(config, seed), np.random.default_rng(1000 + seed)
        turns = sigma_rad * rng.standard_normal((int(scenario.seconds) + 3, 3))
        turns[::2] = 0.0
        values, baseline, sights = triple_differences(turned_pair(scenario, turns))
        sigma = value_sigma_cycles(sigma_rad, baseline, sights, L1_M, _NOISE_M)
        arm = np.cross(baseline, sights) / L1_M
        for value, own, arms in zip(values, sigma, arm, strict=True):
            known = np.isfinite(value)
            if not known.any():
                continue
            shares.append(float(np.mean(np.round(value[known] + 1.0) == 1.0)))
            expected.append(float(share_right(own[known]).mean()))
            drawn = sigma_rad * rng.standard_normal((_DRAWS, 3)) @ arms[known].T
            spreads.append(float(np.mean(np.abs(drawn) < 0.5, axis=1).var()))
    # Every turn enters two differences, going there and coming back: as good as one.
    count = len(shares) // 2
    error = math.sqrt(float(np.mean(spreads)) / count)
    share, theory = float(np.mean(shares)), float(np.mean(expected))
    return Figure(
        f"turns of 1σ {math.degrees(sigma_rad):.2f}° by axis: 1 cycle found",
        f"{100.0 * share:.2f} ± {100.0 * error:.2f} %, theory {100.0 * theory:.2f} %"
        f" ({count} turns × {values.shape[1]} pairs)",
        abs(share - theory) <= 3.0 * error,
    )
