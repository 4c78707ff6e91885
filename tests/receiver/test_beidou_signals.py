"""B1I codes and NH code: by their own properties, and found in recordings of others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.frames import C_ne, ecef
from deepgnss.core.records import BDS_B1I
from deepgnss.core.time import GpsTime
from deepgnss.io.rinex_nav import read_nav
from deepgnss.receiver.orbits import predict, select
from deepgnss.receiver.signals import (
    BDS_B1I_D1,
    BDS_B1I_D2,
    NH20,
    SIGNALS,
    b1i_code,
    code_runs,
    signal_of,
)

# First eleven chips of PRN 1–63 less those of G1, as a generator with one register per satellite
# is loaded with (from another implementation, in hexadecimal).
G2_START = (
    "187 639 1e6 609 605 1f8 606 1f9 704 7be 061 78e 782 07f 781 07e 7df 030 03c 7c1 03f 7c0 7ef "
    "7e3 01e 7e0 01f 00c 7f1 00f 7f0 7fd 003 7fc 7fe 001 7ff 457 4ed 4dd 4d1 4d2 32d 48c 492 4bc "
    "4b0 4b3 34c 4a2 4ae 4ad 352 5d0 5b1 5af 50b 515 53b 537 534 2cb 525"
)
G1_START = "01010101010"


def test_first_chips_of_every_satellite() -> None:
    for prn, start in enumerate(G2_START.split(), start=1):
        bits = "".join(str((1 - chip) // 2) for chip in b1i_code(prn)[:11])
        assert int(bits, 2) ^ int(G1_START, 2) == int(start, 16), prn


def test_codes_are_nearly_orthogonal() -> None:
    """The lost chip costs a Gold code its three values; what is left stays below −19.7 dB."""
    spectra = np.fft.rfft([b1i_code(prn) for prn in range(1, 64)])
    for first in range(63):
        products = np.fft.irfft(spectra[first] * spectra[: first + 1].conj(), 2046)
        assert products[first, 0] == pytest.approx(2046)
        products[first, 0] = 0.0
        assert np.abs(products).max() < 0.1035 * 2046


def test_runs_unroll_to_the_code() -> None:
    for prn in (1, 6, 37, 38, 63):
        runs = code_runs("BDS_B1I", prn)
        unrolled = np.repeat(runs.signs, np.diff(runs.edges).astype(int))
        np.testing.assert_array_equal(unrolled, b1i_code(prn))


def test_nh_code() -> None:
    assert "".join(str((1 - chip) // 2) for chip in NH20) == "00000100110101001110"
    nh = np.array(NH20)
    around = [int(nh @ np.roll(nh, shift)) for shift in range(20)]
    assert around[0] == 20
    assert set(around[1:]) == {-4, 0, 4}


def test_every_satellite_has_one_object() -> None:
    assert sorted(BDS_B1I_D1.prns + BDS_B1I_D2.prns) == list(range(1, 64))
    assert SIGNALS["BDS_B1I"] == (BDS_B1I_D1, BDS_B1I_D2)
    for prn in range(1, 64):
        geo = prn <= 5 or prn >= 59
        assert signal_of("BDS_B1I", prn) is (BDS_B1I_D2 if geo else BDS_B1I_D1)
    assert signal_of("GPS_L1CA", 133).id.name == "GPS_L1CA"  # a relative
    for signal in SIGNALS["BDS_B1I"]:
        assert signal.period_s == pytest.approx(1e-3, rel=1e-15)
        assert signal.carrier_to_code == 763.0
        assert signal.satellite(6) == "C06"
    assert BDS_B1I_D1.symbol_s == pytest.approx(0.02)
    assert BDS_B1I_D2.symbol_s == pytest.approx(0.002)


# --- in recordings -------------------------------------------------------------------------------


def test_real_capture(shared_data: Path) -> None:
    """0.65 ms of B1I on the air, less than a code period, laid on the code by FFT."""
    path = shared_data / "real/if/gnss-sdr/BdsB1IStr01_fs25e6_if0_4ms.dat"
    wave = np.fromfile(path, np.complex64).astype(np.complex128)
    rate_hz, count = 25e6, 25_000
    seconds = np.arange(wave.size) / rate_hz
    chips = np.floor(np.arange(count) * (BDS_B1I.chip_rate_hz / rate_hz)).astype(int)
    found = {}
    for prn in (13, 6, 12, 33):
        code = np.fft.fft(b1i_code(prn)[chips])
        best = (0.0, 0.0)
        for doppler_hz in np.arange(-5000.0, 5001.0, 500.0):
            turned = np.zeros(count, dtype=np.complex128)
            turned[: wave.size] = wave * np.exp(-2j * np.pi * doppler_hz * seconds)
            power = np.abs(np.fft.ifft(np.fft.fft(turned).conj() * code)) ** 2
            top = int(power.argmax())
            away = np.abs((np.arange(count) - top + count // 2) % count - count // 2) > 25
            best = max(best, (float(power[top] / power[away].max()), float(doppler_hz)))
        found[prn] = best
    assert found[13][0] > 5.0
    assert found[6][0] > 3.0
    assert max(found[12][0], found[33][0]) < 2.5


def test_every_satellite_of_another_simulator_is_where_its_orbit_says(shared_data: Path) -> None:
    """20 ms of dual/b1.bin: Doppler and code phase by the NAV file, at 5° and above."""
    rate_hz, count = 4.5e6, 4500
    folder = shared_data / "independent/dual"
    nav = read_nav(folder / "ESBC00DNK_R_20201770000_01D_MN.rnx.gz")
    start, lat, lon = GpsTime(2111, 388_818.0), np.radians(55.4935), np.radians(8.4568)
    v_e_mps = C_ne(lat, lon).T @ (10.0 * np.sqrt(0.5) * np.array([1.0, 1.0, 0.0]))
    sets = [select(nav, name, start) for name in nav.ephemerides if name[0] == "C"]
    chosen = [ephemeris for ephemeris in sets if ephemeris is not None]
    seen = predict(chosen, start, ecef(lat, lon, 60.0), v_e_mps)
    bits = np.unpackbits(np.fromfile(folder / "b1.bin", np.uint8, count=20 * count // 4))
    values = 1.0 - 2.0 * bits.astype(np.float64)
    wave = values[0::2] + 1j * values[1::2]
    seconds = np.arange(wave.size) / rate_hz
    found = {}
    for k, ephemeris in enumerate(chosen):
        if seen.elevation_rad[k] < np.radians(5.0):
            continue
        doppler_hz = -seen.pseudorange_rate_mps[k] / SPEED_OF_LIGHT_MPS * BDS_B1I.carrier_hz
        chips = np.floor(np.arange(count) * (BDS_B1I.chip_rate_hz / rate_hz)).astype(int)
        padded = np.zeros(2 * count)  # 1 ms of code in 2 ms: a change of sign splits nothing
        padded[:count] = b1i_code(int(ephemeris.satellite[1:]))[chips]
        code = np.conj(np.fft.fft(padded))
        powers = []
        for off_hz in (-250.0, 0.0, 250.0):
            turned = wave * np.exp(-2j * np.pi * (doppler_hz + off_hz) * seconds)
            pieces = np.array([turned[n * count :][: 2 * count] for n in range(18)])
            sums = np.fft.ifft(np.fft.fft(pieces) * code)[:, :count]
            powers.append((np.abs(sums) ** 2).sum(axis=0))
        tops = [float(power.max()) for power in powers]
        assert tops[1] == max(tops)
        top = int(powers[1].argmax())
        sent_s = start.tow_s - seen.pseudorange_m[k] / SPEED_OF_LIGHT_MPS
        late = (top + sent_s * rate_hz + 0.5 * count) % count - 0.5 * count
        assert abs(late) < 1.2, ephemeris.satellite  # the atmosphere makes it late by up to 0.5
        away = np.abs((np.arange(count) - top + count // 2) % count - count // 2) > 5
        found[ephemeris.satellite] = tops[1] / powers[1][away].max()
    assert len(found) == 12
    assert "C05" in found
    assert min(found.values()) > 3.0
