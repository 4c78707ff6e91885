"""Tight coupling on synthetic ranges of two systems, down to two satellites."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from driving import LEVER_B_M, MTI_G, START, Drive, drive, sensed, started
from scipy.stats import chi2

from deepgnss.core.frames import C_ne, ecef
from deepgnss.core.records import FloatArray
from deepgnss.ins.error_model import process_noise
from deepgnss.ins.error_state import Estimate, Layout, difference
from deepgnss.ins.imu_errors import SensorErrors
from deepgnss.ins.integration import Integration, Settings, integrate
from deepgnss.ins.ranging import ClockNoise, RangeEpoch, RangeObservation
from deepgnss.ins.updates import counts

LAYOUT = Layout(15, systems=("G", "C"))
CLOCK = ClockNoise(0.05, 0.02, 0.0)
BIAS_M, DRIFT_MPS, BETWEEN_M = 3e4, 150.0, 25.0
OUTAGE_S = (60.0, 100.0)
SKY_DEG = {  # azimuth and elevation
    "G01": (20.0, 60.0), "G02": (80.0, 25.0), "G03": (150.0, 40.0), "G04": (230.0, 20.0),
    "C06": (300.0, 55.0), "C07": (340.0, 15.0), "C08": (190.0, 75.0), "C09": (110.0, 30.0),
}  # fmt: skip


def satellites(time_s: float) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Positions and velocities in ECEF, evenly moving across the line of sight."""
    to_e, here = C_ne(0.53, 1.99).T, ecef(0.53, 1.99, 30.0)
    found = {}
    for k, (name, (azimuth, elevation)) in enumerate(SKY_DEG.items()):
        a, e = np.radians([azimuth, elevation])
        line_n = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), -np.sin(e)])
        v_n = 2500.0 * np.array([-np.sin(a), np.cos(a), 0.2]) * (-1) ** k
        found[name] = (here + to_e @ (2.2e7 * line_n + v_n * time_s), to_e @ v_n)
    return found


def observed(
    truth: Drive, rng: np.random.Generator, in_outage: tuple[str, ...]
) -> list[RangeEpoch]:
    """Ranges at 1 Hz with white errors and a walking clock; few satellites in the outage."""
    bias_m, drift_mps, epochs = BIAS_M, DRIFT_MPS, []
    for time_s in np.arange(1.0, 130.0):
        walk = rng.normal(size=2)
        bias_m += drift_mps + CLOCK.bias_m_rts * walk[0]
        drift_mps += CLOCK.drift_mps_rts * walk[1]
        point = truth.vehicle.point(np.array([time_s]), (0.4, 0.1, -1.2))
        r_e, v_e = point.r_m[0], point.v_mps[0]
        names = in_outage if OUTAGE_S[0] < time_s < OUTAGE_S[1] else tuple(SKY_DEG)
        found = []
        for name, (sat_m, sat_mps) in satellites(float(time_s)).items():
            if name not in names:
                continue
            line = sat_m - r_e
            range_m = np.linalg.norm(line)
            between_m = BETWEEN_M if name[0] == "C" else 0.0
            rate = line @ (sat_mps - v_e) / range_m
            found.append(
                RangeObservation(
                    name,
                    name[0],
                    sat_m,
                    sat_mps,
                    float(range_m + bias_m + between_m + 2.0 * rng.normal()),
                    2.0,
                    float(rate + drift_mps + 0.05 * rng.normal()),
                    0.05,
                )
            )
        epochs.append(RangeEpoch(START.plus(float(time_s)), tuple(found)))
    return epochs


def coupled(
    seed: int, in_outage: tuple[str, ...], spoil: tuple[int, float] | None = None
) -> tuple[Drive, Integration, SensorErrors]:
    """Run over 130 s; spoil: metres too much on the first satellite of an epoch."""
    truth, rng = drive(130.0), np.random.default_rng([seed, 4])
    grade = MTI_G._replace(gyro_scale=0.0, accel_scale=0.0)
    block, errors = sensed(truth, grade, seed)
    begun = started(truth, grade, errors, Layout(15), rng, position_m=5.0)
    P = np.diag([0.0] * 15 + [1e3**2, 30.0**2, 100.0**2])
    P[:15, :15] = begun.P
    start = Estimate(LAYOUT, begun.ins, np.array([BIAS_M, DRIFT_MPS, 0.0]), P)
    epochs = observed(truth, rng, in_outage)
    if spoil is not None:
        k, metres = spoil
        first, *others = epochs[k].observations
        false = replace(first, pseudorange_m=first.pseudorange_m + metres)
        epochs[k] = replace(epochs[k], observations=(false, *others))
    run = integrate(
        block,
        [],
        lambda _: start,
        process_noise(grade),
        Settings(LEVER_B_M, clock=CLOCK, epoch_s=1.0, false_alarm=1e-6),
        ranges=epochs,
    )
    return truth, run, errors


def errors_at(
    found: tuple[Drive, Integration, SensorErrors], time_s: float
) -> tuple[FloatArray, Estimate]:
    truth, run, errors = found
    times = [epoch.estimate.ins.time.since(START) for epoch in run.epochs]
    estimate = run.epochs[int(np.searchsorted(times, time_s + 1e-6)) - 1].estimate
    return difference(estimate.ins, truth.state(estimate.ins.time.since(START), errors)), estimate


def test_ranges_alone_carry_the_navigation_and_the_clock() -> None:
    nees, seeds = [], range(3)
    for seed in seeds:
        found = coupled(seed, tuple(SKY_DEG))
        tally = counts(found[1].innovations)
        assert tally["pseudorange"].tested == 8 * 129
        assert tally["range rate"] == (8 * 129, 0)
        x, estimate = errors_at(found, 120.0)
        nees.append(x[:15] @ np.linalg.solve(estimate.P[:15, :15], x[:15]))
        assert np.linalg.norm(x[:3]) < 4.0
        between = estimate.extra(LAYOUT.inter_system("C"))
        assert abs(between - BETWEEN_M) < 4.0 * np.sqrt(estimate.P[17, 17])
        assert abs(estimate.extra(LAYOUT.clock + 1) - DRIFT_MPS) < 1.5  # it walks by 0.02·√120
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 15 * len(seeds)) / len(seeds)
    assert low < np.mean(nees) < high


def test_two_satellites_still_help_through_an_outage() -> None:
    none, two = (
        np.sqrt(
            np.mean([np.sum(errors_at(coupled(seed, sky), 99.0)[0][:3] ** 2) for seed in range(3)])
        )
        for sky in ((), ("G01", "G04"))
    )
    print(f"after 39 s: {none:.1f} m with no satellite, {two:.1f} m with two")
    assert two < 0.6 * none


def test_a_false_range_is_refused_alone() -> None:
    _, run, _ = coupled(3, tuple(SKY_DEG), spoil=(49, 60.0))
    refused = [i for i in run.innovations if not i.accepted]
    assert [(i.kind, round(i.time.since(START))) for i in refused] == [("pseudorange", 50)]
