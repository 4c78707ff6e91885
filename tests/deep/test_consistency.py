"""A run against what it was told: common drift of code minus carrier, and the date."""

from dataclasses import replace

import pytest

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.errors import InputFileError
from deepgnss.core.records import GPS_L1CA, Epoch, NavData, Observation, SampleInstant
from deepgnss.core.time import GpsTime
from deepgnss.deep.consistency import CodeMinusCarrier, check_week
from deepgnss.sim.constellation import nominal_gps

WAVELENGTH_M = SPEED_OF_LIGHT_MPS / GPS_L1CA.carrier_hz
START = GpsTime(2290, 604_795.0)  # arcs run over the end of a week


def observation(
    prn: int,
    seconds: float,
    drift_mps: float,
    *,
    before_slip: bool = False,
    slip: bool = False,
    valid: bool = True,
) -> Observation:
    """One of a satellite that comes nearer; before a slip the phase counts 5000 cycles less."""
    time = START.plus(seconds)
    range_m = 2.1e7 + 1e5 * prn - 700.0 * seconds
    return Observation(
        satellite=f"G{prn:02d}",
        signal=GPS_L1CA.name,
        pseudorange_m=range_m + drift_mps * seconds,
        carrier_cycles=range_m / WAVELENGTH_M - (5e3 if before_slip else 0.0),
        doppler_hz=700.0 / WAVELENGTH_M,
        cn0_dbhz=45.0,
        lock_time_s=seconds,
        slip=slip,
        half_cycle=False,
        carrier_valid=valid,
        transmit=time.plus(-0.07),
    )


def drift_over(epochs: list[tuple[float, list[Observation]]]) -> float | None:
    check = CodeMinusCarrier()
    for seconds, observations in epochs:
        check.add(Epoch(START.plus(seconds), SampleInstant(0, 0.0), tuple(observations)))
    return check.drift_mps


def test_drift_has_the_sign_of_the_code() -> None:
    epochs = [(t, [observation(prn, t, -30.0) for prn in (1, 2, 3)]) for t in range(0, 11)]
    assert drift_over(epochs) == pytest.approx(-30.0, abs=1e-6)


def test_one_satellite_does_not_sway_the_others() -> None:
    drifts = {1: 0.0, 2: 0.01, 3: -0.01, 4: 500.0}
    epochs = [(t, [observation(prn, t, d) for prn, d in drifts.items()]) for t in range(0, 9)]
    assert drift_over(epochs) == pytest.approx(0.005, abs=1e-6)


def test_slips_and_gaps_of_the_phase_begin_new_arcs() -> None:
    def row(t: int) -> list[Observation]:
        return [
            observation(1, t, 8.0, before_slip=t < 3, slip=t == 3),
            observation(2, t, 8.0, before_slip=t < 3, valid=t != 2),
            observation(3, t, 8.0),
        ]

    assert drift_over([(t, row(t)) for t in range(12)]) == pytest.approx(8.0, abs=1e-6)


@pytest.mark.parametrize(("seconds", "satellites"), [(3, 5), (20, 2)])
def test_little_is_nothing(seconds: int, satellites: int) -> None:
    epochs = [
        (t, [observation(prn, t, 99.0) for prn in range(1, satellites + 1)])
        for t in range(seconds + 1)
    ]
    assert drift_over(epochs) is None


def test_ephemerides_sent_must_be_of_the_day() -> None:
    sent = nominal_gps(START, 60.0)
    (satellite, several), *_ = sent.ephemerides.items()
    week_off = tuple(replace(e, toe=e.toe.plus(-604_800.0)) for e in several)
    given = NavData({satellite: week_off})
    check_week(START, given, given)  # nothing decoded: nothing to hold it against
    check_week(START, NavData(), sent)
    both = NavData({satellite: (*week_off, *several)})
    check_week(START, given, both)
    with pytest.raises(InputFileError, match=rf"{satellite} sends .* 7\.\d days from"):
        check_week(START.plus(-604_800.0), given, both)
