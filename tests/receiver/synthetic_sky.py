"""A constellation and its observations, for tests that need no files."""

from collections.abc import Mapping

import numpy as np

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS as C
from deepgnss.core.records import (
    SIGNAL_IDS,
    Ephemeris,
    Epoch,
    FloatArray,
    Klobuchar,
    NavData,
    Observation,
    SampleInstant,
)
from deepgnss.core.time import GpsTime
from deepgnss.receiver import orbits
from deepgnss.receiver.weights import PvtParameters, delays

WHEN = GpsTime(2190, 302_400.0 + 1234.5)
KLOBUCHAR = Klobuchar(
    (1.211e-8, -7.451e-9, -5.96e-8, 1.192e-7), (1.167e5, -2.458e5, -6.554e4, 1.114e6)
)


def ephemeris(satellite: str, plane: int, slot: int, rng: np.random.Generator) -> Ephemeris:
    """A Walker-like satellite with corrections as large as broadcast ones."""
    toe = GpsTime(WHEN.week, 302_400.0)
    return Ephemeris(
        satellite=satellite,
        toe=toe,
        toc=toe,
        transmitted=toe.plus(-3600.0),
        iode=slot,
        iodc=slot + 256,
        af0_s=rng.uniform(-5e-4, 5e-4),
        af1_sps=rng.uniform(-1e-11, 1e-11),
        af2_sps2=0.0,
        group_delay_s=rng.uniform(-2e-8, 2e-8),
        sqrt_a_rm=5153.6 + rng.uniform(-0.2, 0.2),
        eccentricity=rng.uniform(0.0, 0.02),
        m0_rad=float(np.angle(np.exp(1j * (2 * np.pi * slot / 5 + 0.2 * plane)))),
        delta_n_radps=rng.uniform(4e-9, 5e-9),
        omega0_rad=float(np.angle(np.exp(1j * np.pi / 3 * plane))),
        omega_rad=rng.uniform(-0.3, 0.3),
        omega_dot_radps=rng.uniform(-8.5e-9, -7.5e-9),
        i0_rad=0.96 + rng.uniform(-0.02, 0.02),
        idot_radps=rng.uniform(-5e-10, 5e-10),
        cuc_rad=rng.uniform(-6e-6, 6e-6),
        cus_rad=rng.uniform(-1e-5, 1e-5),
        crc_m=rng.uniform(150.0, 300.0),
        crs_m=rng.uniform(-120.0, 120.0),
        cic_rad=rng.uniform(-3e-7, 3e-7),
        cis_rad=rng.uniform(-3e-7, 3e-7),
        health=0,
        accuracy_m=2.0,
    )


def sky(systems: str = "G", seed: int = 1) -> NavData:
    """Thirty satellites of each system in six planes."""
    rng = np.random.default_rng(seed)
    names = [(f"{s}{n + 6:02d}", n % 6, n // 6) for s in systems for n in range(30)]
    return NavData(
        {name: (ephemeris(name, plane, slot, rng),) for name, plane, slot in names},
        {"G": KLOBUCHAR},
    )


def observe(
    nav: NavData,
    r_e_m: FloatArray,
    v_e_mps: FloatArray,
    parameters: PvtParameters,
    *,
    clock_s: float = 2e-4,
    drift_sps: float = 3e-7,
    isb_s: Mapping[str, float] | None = None,
    time: GpsTime = WHEN,
    lowest_rad: float = 0.0,
) -> Epoch:
    """What an error-free receiver sees; its time tag is `clock_s` ahead of GPST."""
    satellites = sorted(nav.ephemerides)
    chosen = [nav.ephemerides[s][0] for s in satellites]
    truth = orbits.predict(chosen, time, r_e_m, v_e_mps)
    signals = ["GPS_L1CA" if s[0] == "G" else "BDS_B1I" for s in satellites]
    carriers_hz = np.array([SIGNAL_IDS[signal].carrier_hz for signal in signals])
    tag = time.plus(clock_s)
    delay_m, _ = delays(
        nav, parameters, tag, r_e_m, truth.azimuth_rad, truth.elevation_rad, carriers_hz
    )
    biases_s = np.array([clock_s + (isb_s or {}).get(s[0], 0.0) for s in satellites])
    ranges_m = truth.pseudorange_m + delay_m + C * biases_s
    rates_mps = (truth.pseudorange_rate_mps + C * drift_sps) / (1.0 + drift_sps)
    return Epoch(
        tag,
        SampleInstant(0, 0.0),
        tuple(
            Observation(
                satellite=satellites[k],
                signal=signals[k],
                pseudorange_m=float(ranges_m[k]),
                carrier_cycles=0.0,
                doppler_hz=float(-rates_mps[k] * carriers_hz[k] / C),
                cn0_dbhz=45.0,
                lock_time_s=10.0,
                slip=False,
                half_cycle=False,
                carrier_valid=False,
                transmit=tag.plus(float(-ranges_m[k] / C)),
            )
            for k in np.flatnonzero(truth.elevation_rad > lowest_rad)
        ),
    )
