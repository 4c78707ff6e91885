"""A position that is told where the antenna is: information adds up, nothing else does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic_sky import observe, sky

from deepgnss.core import frames
from deepgnss.core.records import Epoch, FloatArray
from deepgnss.receiver import pvt
from deepgnss.receiver.beside import Beside, Place, rows_beside
from deepgnss.receiver.weights import ErrorModel

NAV = sky("GC")
SIGMA_M = 2.0
MODEL = ErrorModel(orbit=0.0, multipath_m=0.0, code_noise_m=SIGMA_M, rate_floor_mps=0.1)
PARAMETERS = pvt.PvtParameters(
    elevation_mask_rad=np.radians(5.0), ionosphere="none", troposphere="none", errors=MODEL
)
LAT, LON = 0.53, 1.99
HERE_E_M = frames.ecef(LAT, LON, 40.0)
TO_N = frames.C_ne(LAT, LON)
V_E_MPS = TO_N.T @ np.array([12.0, -7.0, 0.5])
EPOCH = observe(NAV, HERE_E_M, V_E_MPS, PARAMETERS, lowest_rad=np.radians(6.0))
P_E_M2 = TO_N.T @ np.array([[1.0, 0.6, 0.1], [0.6, 2.0, 0.0], [0.1, 0.0, 4.0]]) @ TO_N
V_E_M2PS2 = 0.04 * np.eye(3)


def some(count: int, system: str = "GC") -> Epoch:
    seen = [o for o in EPOCH.observations if o.satellite[0] in system][:count]
    return replace(EPOCH, observations=tuple(o._replace(cn0_dbhz=45.0) for o in seen))


def place(off_e_m: FloatArray | None = None) -> Place:
    off_e_m = np.zeros(3) if off_e_m is None else off_e_m
    return Place(HERE_E_M + off_e_m, V_E_MPS, P_E_M2, V_E_M2PS2)


@pytest.mark.parametrize("systems", [1, 2])
def test_satellites_that_only_tell_the_clock_give_the_place_back(systems: int) -> None:
    """One satellite a time system: as many unknown clocks as ranges."""
    off_e_m = TO_N.T @ np.array([1.0, -2.0, 3.0])
    one = [some(1, "G"), some(1, "C")][:systems]
    epoch = replace(one[0], observations=tuple(o for e in one for o in e.observations))
    got = pvt.solve(epoch, NAV, PARAMETERS, place=place(off_e_m))
    assert got.valid, got.reason
    assert np.abs(got.r_e_m - HERE_E_M - off_e_m).max() < 1e-6
    assert got.covariance_m2[:3, :3] == pytest.approx(P_E_M2, rel=1e-9)
    assert got.v_e_mps == pytest.approx(V_E_MPS, abs=1e-3)  # metres off, directions turn
    assert got.dops == {}
    assert len(got.used) == systems
    if systems == 1:  # clocks of all systems drift together
        found = got.velocity_covariance_m2ps2[:3, :3]
        assert found == pytest.approx(V_E_M2PS2, rel=1e-6, abs=1e-9)


def test_without_it_three_satellites_are_no_position() -> None:
    assert not pvt.solve(some(3, "G"), NAV, PARAMETERS).valid


def test_information_adds_up() -> None:
    """Inverse covariances of ranges alone and of the place alone, for position and velocity."""
    epoch = some(6, "G")
    alone = pvt.solve(epoch, NAV, PARAMETERS)
    both = pvt.solve(epoch, NAV, PARAMETERS, place=place())
    for own, added, got in (
        (alone.covariance_m2, P_E_M2, both.covariance_m2),
        (alone.velocity_covariance_m2ps2, V_E_M2PS2, both.velocity_covariance_m2ps2),
    ):
        information = np.linalg.inv(own)
        information[:3, :3] += np.linalg.inv(added)
        assert np.linalg.inv(information) == pytest.approx(got, rel=1e-6, abs=1e-9)
    assert both.dops == pytest.approx(alone.dops)  # of the satellites alone


def test_rows_are_the_slope_of_what_they_say() -> None:
    known, step = Beside({"C": (30.0, 2.0)}, place()), np.array([1.0, -2.0, 0.5])
    before, after = (rows_beside(["G", "C"], known, HERE_E_M + s) for s in (0.0 * step, step))
    assert before.H[:, :3] @ step == pytest.approx(before.values - after.values, abs=1e-6)
    assert before.H[0] == pytest.approx([0.0, 0.0, 0.0, -1.0, 1.0])
    white = before.H[1:, :3]
    assert white @ P_E_M2 @ white.T == pytest.approx(np.eye(3), abs=1e-9)


def test_three_satellites_and_a_place_err_as_they_say() -> None:
    """NEES of position and clock over 400 draws: 4 ± 0.14 (1σ)."""
    rng, epoch = np.random.default_rng(1), some(3, "G")
    root = np.linalg.cholesky(P_E_M2)
    nees = []
    for _ in range(400):
        noisy = tuple(
            o._replace(pseudorange_m=o.pseudorange_m + e)
            for o, e in zip(epoch.observations, rng.normal(0.0, SIGMA_M, 3), strict=True)
        )
        told = place(root @ rng.normal(size=3))
        got = pvt.solve(replace(epoch, observations=noisy), NAV, PARAMETERS, place=told)
        error = np.append(got.r_e_m - HERE_E_M, (got.clock_s - 2e-4) * 299792458.0)
        nees.append(float(error @ np.linalg.solve(got.covariance_m2, error)))
    assert np.mean(nees) == pytest.approx(4.0, abs=0.5)


def test_a_range_that_contradicts_the_place_goes_where_ranges_alone_say_nothing() -> None:
    """Four satellites agree on any wrong place: only the prediction tells which one lies."""
    epoch = some(4, "G")
    liar = epoch.observations[1].satellite
    wrong = replace(
        epoch,
        observations=tuple(
            o._replace(pseudorange_m=o.pseudorange_m + 60.0 * (o.satellite == liar))
            for o in epoch.observations
        ),
    )
    assert not pvt.solve(wrong, NAV, PARAMETERS).rejected
    got = pvt.solve(wrong, NAV, PARAMETERS, place=place())
    assert set(got.rejected) == {liar}
    assert np.abs(got.r_e_m - HERE_E_M).max() < 1e-3
