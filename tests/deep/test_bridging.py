"""Phases, clock and trust from tag to tag, against the simulator's exact ranges."""

from __future__ import annotations

import numpy as np
import pytest
from exact_tags import LOOP, STEP_S, Tags, Told

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import FloatArray, Oscillator
from deepgnss.deep.arcs import Slip
from deepgnss.deep.bridging import Bridge
from deepgnss.io.config.imu_grade import imu_grade

STEADY = Oscillator("steady", 1e-26, 0.0, 1e-27, 0.0)
TCXO = Oscillator("TCXO", 1e-21, 1e-21, 2e-20, 0.0)
OCXO = Oscillator("OCXO", 2.51e-26, 2.51e-23, 2.51e-22, 0.0)


def _slips(told: list[Told]) -> list[tuple[float, Slip]]:
    return [(one.time_s, slip) for one in told for slip in one.bridged.slips]


def _names(tags: Tags) -> list[str]:
    return [emitter.satellite for emitter in tags.scenario.emitters]


def _carried(tags: Tags, told: list[Told], since_s: float) -> tuple[FloatArray, FloatArray]:
    """Errors and told 1σ of phases carried on, (tags, satellites)."""
    errors, sigmas, moved = [], [], dict.fromkeys(_names(tags), 0.0)
    for one in told:
        if one.bridged.moves:
            for satellite, move in one.bridged.moves.items():
                moved[satellite] += move.cycles
            # The generators began 0.3 cycles off.
            errors.append([0.3 + moved[s] for s in one.bridged.moves])
            sigmas.append([m.sigma_cycles for m in one.bridged.moves.values()])
    assert told[0].time_s < since_s
    return np.array(errors), np.array(sigmas)


# --- sign and unit of every term -----------------------------------------------------------------


def test_exact_phases_show_the_velocity_error_and_the_clock() -> None:
    """GPS and BeiDou, moving, atmosphere, a clock model 40 ns/s off the clock."""
    wrong_n_mps = np.array([0.05, -0.03, 0.02])
    tags = Tags(12.0, velocity_error_n_mps=wrong_n_mps)
    assert {name[0] for name in _names(tags)} == {"G", "C"}
    bridge = Bridge(STEADY, LOOP)
    told = tags.run(bridge)
    assert not _slips(told)
    found = bridge.velocity_error_n_mps
    assert found is not None
    np.testing.assert_allclose(found, wrong_n_mps, atol=3e-4)
    assert told[-1].drift_sps == pytest.approx(tags.drift_sps, abs=1e-12)


def test_corrections_of_the_navigation_are_followed() -> None:
    """It is corrected by some cm/s at every tag, and the phases are still what was expected."""
    tags = Tags(15.0, velocity_error_n_mps=np.array([0.02, 0.0, -0.01]))
    told = tags.run(Bridge(STEADY, LOOP), lambda _, t: 10.0 < t < 15.0, corrections_n_mps=0.03)
    assert not _slips(told)
    errors, _ = _carried(tags, told, 10.0)
    assert np.abs(errors[-1]).max() < 0.02


@pytest.mark.parametrize("oscillator", [TCXO, OCXO])
def test_drift_follows_the_oscillator(oscillator: Oscillator) -> None:
    """As well as white noise, flicker and walk of its frequency within a step allow."""
    tags = Tags(20.0, oscillator=oscillator, cn0_dbhz=45.0)
    told = tags.run(Bridge(oscillator, LOOP))
    seen = np.array([one.drift_sps for one in told])
    ahead = np.diff(tags.clock_s) / STEP_S
    white2 = oscillator.h0_s / 2.0 / STEP_S
    walk2 = 2.0 * np.pi**2 * oscillator.h_2_hz * STEP_S
    flicker2 = 2.0 * np.log(2.0) * oscillator.h_1
    noise2 = 5e-12**2  # 1.5 mm/s
    limit_sps = 2.5 * np.sqrt(white2 + walk2 + flicker2 + noise2)
    assert np.std((seen[:-1] - ahead)[100:]) < limit_sps


# --- cycle slips ---------------------------------------------------------------------------------


@pytest.mark.parametrize("lasts_s", [0.01, 0.3])
@pytest.mark.parametrize("cycles", [-3.0, -1.0, -0.5, 0.5, 1.0, 3.0])
def test_a_slip_is_found_and_put_right(cycles: float, lasts_s: float) -> None:
    tags = Tags(12.0, cn0_dbhz=45.0, oscillator=OCXO, grade=imu_grade("MTi-G"), satellites=6)
    satellite = _names(tags)[2]
    told = tags.run(Bridge(OCXO, LOOP), slips=[(satellite, cycles, 8.03, lasts_s)])
    ((at_s, slip),) = _slips(told)
    assert (slip.satellite, slip.cycles) == (satellite, cycles)
    assert 8.0 < at_s < 9.2


@pytest.mark.parametrize("second", [0.5, -3.0])
def test_two_slips_at_once(second: float) -> None:
    tags = Tags(12.0, cn0_dbhz=45.0, oscillator=OCXO, grade=imu_grade("MTi-G"), satellites=6)
    names = _names(tags)
    slips = [(names[0], 0.5, 8.03, 0.1), (names[4], second, 8.03, 0.2)]
    found = {
        slip.satellite: slip.cycles for _, slip in _slips(tags.run(Bridge(OCXO, LOOP), slips=slips))
    }
    assert found == {names[0]: 0.5, names[4]: second}


def test_a_slip_of_no_half_number_is_not_put_right() -> None:
    tags = Tags(12.0, cn0_dbhz=45.0, oscillator=OCXO, grade=imu_grade("MTi-G"), satellites=6)
    satellite = _names(tags)[1]
    ((_, slip),) = _slips(tags.run(Bridge(OCXO, LOOP), slips=[(satellite, 0.75, 8.0, 0.1)]))
    assert (slip.satellite, slip.cycles) == (satellite, None)


def test_a_phase_that_runs_away_is_found_alone() -> None:
    """A spoofer's: 0.4 cycles/s, then more."""
    tags = Tags(14.0, cn0_dbhz=45.0, oscillator=OCXO, grade=imu_grade("MTi-G"), satellites=6)
    satellite = _names(tags)[1]
    told = tags.run(Bridge(OCXO, LOOP), slips=[(satellite, 20.0, 8.0, 6.0)])
    assert {slip.satellite for _, slip in _slips(told)} == {satellite}


@pytest.mark.parametrize("cn0_dbhz", [47.0, 35.0, 26.0])
def test_quiet_tracking_has_no_slips(cn0_dbhz: float) -> None:
    tags = Tags(40.0, cn0_dbhz=cn0_dbhz, oscillator=TCXO, grade=imu_grade("MTi-G"))
    told = tags.run(Bridge(TCXO, LOOP))
    assert not _slips(told)
    assert all(one.bridged.clock_jump_m is None for one in told)


@pytest.mark.slow
@pytest.mark.parametrize("cn0_dbhz", [47.0, 35.0, 26.0])
def test_an_hour_of_quiet_tracking_has_no_slips(cn0_dbhz: float) -> None:
    tags = Tags(3600.0, cn0_dbhz=cn0_dbhz, oscillator=TCXO, grade=imu_grade("MTi-G"))
    told = tags.run(Bridge(TCXO, LOOP))
    assert not _slips(told)


@pytest.mark.parametrize("jump_s", [3e-9, -1e-6])
def test_a_jump_of_the_clock_is_no_slip_of_all(jump_s: float) -> None:
    tags = Tags(12.0, cn0_dbhz=45.0, oscillator=OCXO, grade=imu_grade("FSAS"), satellites=6)
    told = tags.run(Bridge(OCXO, LOOP), clock_jump=(8.0, jump_s))
    assert not _slips(told)
    (jump_m,) = [one.bridged.clock_jump_m for one in told if one.bridged.clock_jump_m]
    assert jump_m == pytest.approx(jump_s * SPEED_OF_LIGHT_MPS, abs=0.02)


@pytest.mark.parametrize("step_m", [0.15, -2.0])
def test_a_step_of_the_navigation_is_no_slip_of_all(step_m: float) -> None:
    """Most phases agree that the antenna has not gone where the navigation says."""
    tags = Tags(12.0, cn0_dbhz=45.0, oscillator=OCXO, grade=imu_grade("FSAS"), step=(8.0, step_m))
    assert not _slips(tags.run(Bridge(OCXO, LOOP)))


def test_with_most_phases_slipping_none_is_taken_for_sound() -> None:
    """Five of eight at once, each by another number: none of these stays unnoticed."""
    tags = Tags(12.0, cn0_dbhz=45.0, oscillator=OCXO, grade=imu_grade("FSAS"))
    slips = [(s, 1.0 + k, 8.0, 0.1) for k, s in enumerate(_names(tags)[:5])]
    found = {slip.satellite for _, slip in _slips(tags.run(Bridge(OCXO, LOOP), slips=slips))}
    assert found == set(_names(tags)[:5])


# --- open loop -----------------------------------------------------------------------------------


def test_one_blocked_satellite_is_carried_on_by_the_others() -> None:
    tags = Tags(32.0, cn0_dbhz=45.0, oscillator=TCXO, grade=imu_grade("MTi-G"))
    blocked = _names(tags)[1]
    told = tags.run(Bridge(TCXO, LOOP), lambda s, t: s == blocked and t > 10.0)
    errors, sigmas = _carried(tags, told, 10.0)
    assert np.abs(errors[5:]).max() < 0.05
    assert sigmas[-1, 0] < 0.05


def test_what_models_leave_of_rates_is_learnt_before_a_loop_opens() -> None:
    """0.1 mm/s 1σ in every phase: 20 mcycles after 20 s for who asks only the others."""
    errors, sigmas = [], []
    for seed in range(4):
        tags = Tags(45.0, cn0_dbhz=45.0, oscillator=OCXO, grade=imu_grade("MTi-G"), seed=seed)
        blocked = _names(tags)[seed]
        rates_mps = 1e-4 * np.random.default_rng(seed).standard_normal(tags.satellites)
        ramps = [
            (e.satellite, mps * 45.0 / SPEED_OF_LIGHT_MPS * e.signal.id.carrier_hz, 0.0, 45.0)
            for e, mps in zip(tags.scenario.emitters, rates_mps, strict=True)
        ]
        told = tags.run(Bridge(OCXO, LOOP), lambda s, t, b=blocked: s == b and t > 25.0, ramps)
        assert not _slips(told)
        error, sigma = _carried(tags, told, 25.0)
        errors.append(error[-1, 0])
        sigmas.append(sigma[-1, 0])
    assert np.sqrt(np.mean(np.square(errors))) < 0.010
    assert np.sqrt(np.mean(np.square(np.divide(errors, sigmas)))) < 1.0
    assert max(sigmas) < 0.03


def test_at_rest_only_the_clock_grows() -> None:
    """All blocked: a vehicle that stands does not move, whatever its unit says."""
    grade = imu_grade("MTi-G")
    sigmas = {}
    for at_rest in (False, True):
        tags = Tags(
            14.0,
            cn0_dbhz=45.0,
            oscillator=STEADY,
            grade=None if at_rest else grade,
            at_rest=at_rest,
        )
        told = tags.run(Bridge(STEADY, LOOP), lambda _, t: t > 8.0)
        errors, sigmas[at_rest] = _carried(tags, told, 8.0)
    assert sigmas[True][-1].max() < 0.03 < 0.2 < sigmas[False][-1].max()
    assert np.abs(errors[-1]).max() < 0.02


def _spread(
    grade: str, oscillator: Oscillator, seeds: range, wheels_mps: float | None = None
) -> tuple[FloatArray, FloatArray]:
    """All blocked from 6 s on: errors and σ (seeds, tags, satellites)."""
    runs = []
    for seed in seeds:
        tags = Tags(
            11.0,
            cn0_dbhz=45.0,
            oscillator=oscillator,
            grade=imu_grade(grade),
            satellites=6,
            seed=seed,
            wheels_mps=wheels_mps,
        )
        told = tags.run(Bridge(oscillator, LOOP), lambda _, t: t > 6.0)
        runs.append(_carried(tags, told, 6.0))
    return np.array([errors for errors, _ in runs]), np.array([sigmas for _, sigmas in runs])


@pytest.mark.parametrize(("grade", "oscillator"), [("MTi-G", STEADY), ("FSAS", OCXO)])
def test_sigma_of_phases_in_open_loop_is_their_spread(grade: str, oscillator: Oscillator) -> None:
    errors, sigmas = _spread(grade, oscillator, range(10))
    for after in (10, 30, 48):
        ratio = np.sqrt(np.mean((errors[:, after] / sigmas[:, after]) ** 2))
        assert 0.6 < ratio < 1.5, (after, ratio)


def test_wheels_and_road_hold_a_phase_in_open_loop() -> None:
    """What they say of the way as well as what they let the phases learn of the attitude."""
    errors, sigmas = _spread("MTi-G", STEADY, range(8), wheels_mps=0.05)
    _, alone = _spread("MTi-G", STEADY, range(1))
    assert sigmas[0, 48].mean() < 0.5 * alone[0, 48].mean()
    for after in (30, 48):
        ratio = np.sqrt(np.mean((errors[:, after] / sigmas[:, after]) ** 2))
        assert 0.6 < ratio < 1.5, (after, ratio)


@pytest.mark.parametrize(("grade", "oscillator"), [("MTi-G", OCXO), ("FSAS", TCXO)])
def test_sigma_of_rates_in_open_loop_is_their_spread(grade: str, oscillator: Oscillator) -> None:
    """What a phase carried on gains from tag to tag is what its rate is wrong by."""
    ratios = []
    for seed in range(10):
        unit, count = imu_grade(grade), 6
        tags = Tags(
            11.0, cn0_dbhz=45.0, oscillator=oscillator, grade=unit, satellites=count, seed=seed
        )
        told = tags.run(Bridge(oscillator, LOOP), lambda _, t: t > 6.0)
        errors, _ = _carried(tags, told, 6.0)
        hz = np.diff(errors, axis=0) / STEP_S
        wavelengths = [SPEED_OF_LIGHT_MPS / e.signal.id.carrier_hz for e in tags.scenario.emitters]
        sigma_mps = np.array([one.rate_sigma_mps for one in told])[-hz.shape[0] :]
        ratios.append(hz * wavelengths / sigma_mps)
    for after in (20, 45):
        ratio = np.sqrt(np.mean(np.array(ratios)[:, after] ** 2))
        assert 0.6 < ratio < 1.5, (after, ratio)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("grade", "oscillator"), [("MTi-G", OCXO), ("FSAS", OCXO), ("FSAS", TCXO), ("MTi-G", STEADY)]
)
def test_sigma_over_many_runs(grade: str, oscillator: Oscillator) -> None:
    errors, sigmas = _spread(grade, oscillator, range(100))
    for after in (10, 30, 48):
        ratio = np.sqrt(np.mean((errors[:, after] / sigmas[:, after]) ** 2))
        assert 0.8 < 1.0 / ratio < 1.25, (after, ratio)
