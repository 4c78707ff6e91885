"""Time of a snapshot from symbol edges; the clock of a series' time stamps."""

from __future__ import annotations

import numpy as np
import pytest

from deepgnss.core.time import GpsTime
from deepgnss.receiver.bit_timing import (
    PeriodSums,
    StampClock,
    TimeEvidence,
    edge_evidence,
    edge_log_likelihoods,
    nearest_allowed_s,
)


def sums(
    rng: np.random.Generator, edge: int, number: int, flips: bool, snr: float = 10.0
) -> PeriodSums:
    """Twelve periods with a symbol edge in period `edge` (past the end: none)."""
    n = np.arange(12)
    signs = np.where((n >= edge) & flips, -1.0, 1.0)
    wave = np.sqrt(snr) * signs * np.exp(2j * np.pi * (2.0 * n * 1e-3 + rng.random()))
    wave = wave + rng.normal(0, np.sqrt(0.5), (12, 2)) @ np.array([1.0, 1.0j])
    return PeriodSums(wave, (n + 0.5) * 1e-3, 12.0, number)


def test_a_change_of_sign_shows_the_edge() -> None:
    rng = np.random.default_rng(1)
    for edge in range(2, 11):
        likelihoods = edge_log_likelihoods(sums(rng, edge, 0, True), 20, 8.0)
        assert likelihoods.argmax() == edge
        assert likelihoods[edge] - np.delete(likelihoods, [edge - 1, edge, edge + 1]).max() > 5.0


def test_without_a_change_edges_inside_are_half_as_likely() -> None:
    rng = np.random.default_rng(2)
    likelihoods = edge_log_likelihoods(sums(rng, 12, 0, False, snr=30.0), 20, 8.0)
    outside = [0, *range(12, 20)]
    assert np.ptp(likelihoods[outside]) < 1e-9
    assert likelihoods[0] - likelihoods[6] == pytest.approx(np.log(2.0), abs=1e-3)


def test_all_satellites_agree_on_one_number_of_milliseconds() -> None:
    """Candidate k: a satellite's count is number + k; its symbols start at multiples of 20."""
    rng = np.random.default_rng(3)
    late = 7
    satellites = []
    for number in (1234, 1241, 1250, 1233):
        edge = -(number + late) % 20
        satellites.append(sums(rng, edge, number, True))
    evidence = edge_evidence(satellites, 20)
    assert evidence.shape == (20,)
    assert evidence.argmax() == late


def test_nearest_allowed_time() -> None:
    # Time of reception is minus the clock bias, modulo the period.
    assert nearest_allowed_s(100.0004, -0.0002, 1e-3) == pytest.approx(-0.0002)
    assert nearest_allowed_s(100.0, 0.0002, 1e-3) == pytest.approx(-0.0002)
    assert abs(nearest_allowed_s(100.0005, 0.00031, 1e-3)) <= 0.5e-3


def evidence_at(error_s: float, true_s: float, sigma_s: float, sharp: bool) -> TimeEvidence:
    """Of a fix at true + error: instants of whole ms, edges that name every twentieth."""
    fix_s = true_s + error_s
    nearest_s = round(fix_s * 1e3) * 1e-3 - fix_s
    edges = np.full(20, -30.0 if sharp else 0.0)
    edges[round((true_s - fix_s - nearest_s) * 1e3) % 20] = 0.0
    return TimeEvidence(nearest_s, sigma_s, 1e-3, edges)


def test_edges_sharpen_a_time_that_is_good_enough() -> None:
    sharp = evidence_at(0.0042, 50.0, 0.003, True).estimate()
    assert sharp.correction_s == pytest.approx(-0.0042, abs=1e-4)
    assert sharp.sigma_s < 1e-3
    blunt = evidence_at(0.0042, 50.0, 0.003, False).estimate()
    assert abs(blunt.correction_s) < 1e-3
    assert blunt.sigma_s == pytest.approx(0.003, rel=0.1)
    # 20 ms apart and known to 15 ms: several instants remain.
    assert evidence_at(0.004, 50.0, 0.015, True).estimate().sigma_s > 0.005


def test_series_finds_the_offset_of_its_stamps_and_leaves_a_wrong_one() -> None:
    """Wrong by a whole symbol at first (errors that last), right when more has been seen."""
    rng = np.random.default_rng(4)
    offset_s, clock = 0.137, StampClock()
    week = 2000
    corrected = []
    for n in range(60):
        error_s = 0.021 + rng.normal(0, 0.004) if n < 8 else rng.normal(0, 0.012)
        true_s = 100.0 + n + offset_s
        evidence = evidence_at(error_s, true_s, 0.012, sharp=n % 2 == 0)
        time = GpsTime(week, true_s + error_s)
        clock, estimate = clock.after(GpsTime(week, 100.0 + n), time, evidence)
        corrected.append((error_s + estimate.correction_s, estimate.sigma_s))
    assert clock.offset_s == pytest.approx(offset_s, abs=1.5e-3)
    errors = np.array(corrected[-20:])
    assert np.max(np.abs(errors[:, 0])) < 3e-3
    assert np.max(errors[:, 1]) < 3e-3
