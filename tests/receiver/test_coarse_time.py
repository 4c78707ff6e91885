"""Snapshot positions: from far and from nowhere, with noise, wrong satellites, few satellites."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from synthetic_sky import WHEN, observe, sky
from test_pvt import epochs

from deepgnss.core import frames
from deepgnss.core.constants import SPEED_OF_LIGHT_MPS as C
from deepgnss.core.records import FloatArray
from deepgnss.io.rinex_nav import read_nav
from deepgnss.receiver import coarse_time, pvt
from deepgnss.receiver.coarse_time import CodePhase, Rough
from deepgnss.receiver.weights import PvtParameters

NAV = sky()
OPEN = PvtParameters(elevation_mask_rad=np.radians(5.0))
SEEDS = range(20)
CODE_M, DOPPLER_HZ = 20.0, 3.0


@dataclass(frozen=True)
class Scene:
    """A snapshot with its truth."""

    snapshot: list[CodePhase]
    r_e_m: FloatArray
    v_e_mps: FloatArray
    wrong: set[str]

    def away(self, distance_m: float, rng: np.random.Generator) -> FloatArray:
        """A place on the ground some way off."""
        lat, lon, _ = frames.geodetic(self.r_e_m)
        angle = rng.uniform(0, 2 * np.pi)
        off_n_m = distance_m * np.array([np.cos(angle), np.sin(angle), 0.0])
        return self.r_e_m + frames.C_ne(lat, lon).T @ off_n_m


def scene(
    seed: int, satellites: int = 9, wrong: int = 0, speed_mps: float = 10.0, noise: float = 1.0
) -> Scene:
    """Anywhere on earth, any course; the first satellites are wrong peaks of acquisition."""
    rng = np.random.default_rng(seed)
    lat, lon = np.arcsin(rng.uniform(-0.9, 0.9)), rng.uniform(-np.pi, np.pi)
    r_e_m, course = frames.ecef(lat, lon, 200.0), rng.uniform(0, 2 * np.pi)
    v_e_mps = frames.C_ne(lat, lon).T @ [
        speed_mps * np.cos(course), speed_mps * np.sin(course), 0.0
    ]  # fmt: skip
    epoch = observe(
        NAV,
        r_e_m,
        v_e_mps,
        OPEN,
        clock_s=rng.uniform(0, 1e-3),
        drift_sps=rng.uniform(-3e-6, 3e-6),
        lowest_rad=np.radians(6.0),
    )
    seen = list(epoch.observations)
    rng.shuffle(seen)  # type: ignore[arg-type]
    snapshot = []
    for number, o in enumerate(seen[:satellites]):
        # not o.transmit: a float of the second of week has steps of 0.1 ns, 3 cm
        code_s = (-o.pseudorange_m / C - noise * CODE_M / C * rng.normal()) % 1e-3
        doppler_hz = o.doppler_hz + noise * DOPPLER_HZ * rng.normal()
        if number < wrong:
            code_s, doppler_hz = rng.uniform(0, 1e-3), rng.uniform(-5e3, 5e3)
        snapshot.append(
            CodePhase(o.satellite, o.signal, code_s, doppler_hz, 45.0, CODE_M, DOPPLER_HZ)
        )
    return Scene(snapshot, r_e_m, v_e_mps, {s.satellite for s in snapshot[:wrong]})


def normalized(got: coarse_time.SnapshotFix, truth: Scene) -> float:
    """Squared error of the position over its covariance."""
    e = got.solution.r_e_m - truth.r_e_m
    return float(e @ np.linalg.solve(got.solution.covariance_m2[:3, :3], e))


def check(got: coarse_time.SnapshotFix, truth: Scene) -> None:
    """A valid fix that is right: whole milliseconds, and errors as small as it says itself."""
    assert got.solution.valid, got.solution.reason
    assert normalized(got, truth) < 25.0
    assert abs(got.solution.time.since(WHEN)) < 5.0 * got.time_sigma_s
    e = got.solution.v_e_mps - truth.v_e_mps
    assert e @ np.linalg.solve(got.solution.velocity_covariance_m2ps2[:3, :3], e) < 25.0
    assert got.cost < got.limit
    assert not truth.wrong & set(got.solution.used)


def test_exact_data_give_back_the_truth() -> None:
    truth = scene(1, satellites=10, noise=0.0)
    rough = Rough(WHEN.plus(20.0), r_e_m=truth.away(50e3, np.random.default_rng(1)))
    got = coarse_time.solve(truth.snapshot, NAV, rough, OPEN)
    assert got.solution.valid, got.solution.reason
    # nothing but the loose priors pulls: 50 m/s and 30 s against 3 Hz and 20 m
    assert np.abs(got.solution.r_e_m - truth.r_e_m).max() < 0.2
    assert abs(got.solution.time.since(WHEN)) < 1e-3
    assert np.abs(got.solution.v_e_mps - truth.v_e_mps).max() < 0.02
    assert max(abs(r) for r in got.solution.residuals_m.values()) < 0.1


@pytest.mark.parametrize(
    ("late_s", "distance_m"),
    [(2.0, 1e3), (60.0, 100e3), (-60.0, 150e3), (-60.0, 0.0), (0.0, 150e3)],
)
def test_from_a_rough_place_and_time(late_s: float, distance_m: float) -> None:
    squares = []
    for seed in SEEDS:
        truth = scene(seed)
        place = truth.away(distance_m, np.random.default_rng(seed))
        rough = Rough(WHEN.plus(late_s), 60.0, place, 100e3)
        got = coarse_time.solve(truth.snapshot, NAV, rough, OPEN)
        check(got, truth)
        squares.append(normalized(got, truth))
    assert 1.5 < np.mean(squares) < 4.5  # three states: 3 ± 0.55 (20 draws)


@pytest.mark.parametrize("late_s", [-60.0, 20.0, 300.0])
def test_from_nowhere(late_s: float) -> None:
    for seed in SEEDS:
        truth = scene(seed)
        rough = Rough(WHEN.plus(late_s), time_sigma_s=max(abs(late_s), 30.0))
        check(coarse_time.solve(truth.snapshot, NAV, rough, OPEN), truth)


def test_an_aircraft_at_250_metres_per_second() -> None:
    for seed in SEEDS:
        truth = scene(seed, speed_mps=250.0)
        place = truth.away(50e3, np.random.default_rng(seed))
        rough = Rough(WHEN.plus(-30.0), r_e_m=place, velocity_sigma_mps=150.0)
        check(coarse_time.solve(truth.snapshot, NAV, rough, OPEN), truth)


def test_wrong_satellites_are_left_out_or_nothing_is_claimed() -> None:
    fixes = 0
    for seed in SEEDS:
        truth = scene(seed, satellites=10, wrong=2)
        place = truth.away(50e3, np.random.default_rng(seed))
        got = coarse_time.solve(truth.snapshot, NAV, Rough(WHEN.plus(20.0), r_e_m=place), OPEN)
        if got.solution.valid:
            check(got, truth)
            assert truth.wrong <= set(got.solution.rejected)
            fixes += 1
        else:
            assert got.solution.reason
    assert fixes >= 15


def test_five_satellites_are_enough() -> None:
    right = 0
    for seed in SEEDS:
        truth = scene(seed, satellites=5)
        place = truth.away(30e3, np.random.default_rng(seed))
        rough = Rough(WHEN.plus(10.0), r_e_m=place, velocity_sigma_mps=20.0)
        got = coarse_time.solve(truth.snapshot, NAV, rough, OPEN)
        if got.solution.valid:
            check(got, truth)
            right += 1
    assert right >= 18


def test_four_satellites_and_the_height_are_enough() -> None:
    right = 0
    for seed in SEEDS:
        truth = scene(seed, satellites=4)
        place = truth.away(10e3, np.random.default_rng(seed))
        rough = Rough(WHEN.plus(5.0), 10.0, place, 10e3, 200.0, 20.0, velocity_sigma_mps=20.0)
        got = coarse_time.solve(truth.snapshot, NAV, rough, OPEN)
        if got.solution.valid:
            check(got, truth)
            right += 1
        without = coarse_time.solve(
            truth.snapshot, NAV, replace(rough, height_sigma_m=1e4), OPEN
        ).solution
        assert without.reason == "4 of 5 satellites needed"
    assert right >= 17


def test_a_series_carries_on_from_the_last_fix() -> None:
    truth = scene(3, satellites=7)
    first = coarse_time.solve(
        truth.snapshot,
        NAV,
        Rough(WHEN.plus(10.0), r_e_m=truth.away(2e4, np.random.default_rng(3))),
        OPEN,
    )
    check(first, truth)
    rough = coarse_time.following(first, 0.0)
    again = coarse_time.solve(truth.snapshot, NAV, rough, OPEN)
    check(again, truth)
    four = coarse_time.solve(truth.snapshot[:5], NAV, rough, OPEN)
    check(four, truth)


def test_unhealthy_and_unknown_satellites_are_named() -> None:
    truth = scene(1, satellites=10)
    sick, lost = (s.satellite for s in truth.snapshot[:2])
    sets = dict(NAV.ephemerides)
    sets[sick] = (replace(sets[sick][0], health=63),)
    del sets[lost]
    rough = Rough(WHEN, r_e_m=truth.r_e_m)
    got = coarse_time.solve(truth.snapshot, replace(NAV, ephemerides=sets), rough, OPEN)
    assert got.solution.rejected == {sick: "unhealthy", lost: "no ephemeris"}
    nothing = coarse_time.solve([], NAV, rough, OPEN).solution
    assert not nothing.valid
    assert nothing.reason == "0 of 5 satellites needed"


def test_a_real_receiver_with_its_milliseconds_taken_away(shared_data: Path) -> None:
    """Code phases and Dopplers of a u-blox receiver on a walk, without and with a rough place.

    Every snapshot must find its way back to the place its full pseudoranges give.
    """
    folder = shared_data / "real/gnss/snapper-ubx"
    nav = read_nav(folder / "w00_f9p.nav")
    rng = np.random.default_rng(4)
    apart_m, late_s = [], []
    for epoch in epochs(folder / "w00_f9p.obs", 15):
        full = pvt.solve(epoch, nav, OPEN)
        snapshot = [
            CodePhase(o.satellite, o.signal, code_s, o.doppler_hz, o.cn0_dbhz, 5.0, 1.0)
            for o in epoch.observations
            for code_s in [o.transmit.tow_s % 1e-3]
        ]
        lat, lon, _ = frames.geodetic(full.r_e_m)
        C_ne = frames.C_ne(lat, lon)
        place = full.r_e_m + C_ne.T @ (rng.normal(0.0, 50e3, 3) * [1, 1, 0])
        for rough in (
            Rough(epoch.time.plus(rng.normal(0, 20)), r_e_m=place, velocity_sigma_mps=5.0),
            Rough(epoch.time.plus(rng.normal(0, 20)), velocity_sigma_mps=5.0),
        ):
            got = coarse_time.solve(snapshot, nav, rough, OPEN)
            assert got.solution.valid, got.solution.reason
            apart_m.append(np.linalg.norm((C_ne @ (got.solution.r_e_m - full.r_e_m))[:2]))
            late_s.append(got.solution.time.since(epoch.time.plus(-full.clock_s)))
    assert len(apart_m) == 52
    assert np.median(apart_m) < 2.0
    assert np.max(apart_m) < 60.0
    assert np.max(np.abs(late_s)) < 0.1
