"""Satellites as judges of a recording's description, on made and on real signals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepgnss.core.records import SampleBlock, StreamInfo
from deepgnss.evaluate.satellites import (
    Survey,
    code_drift,
    repetition_rate_hz,
    signals_within,
    survey,
)
from deepgnss.io.formats import StreamFormat
from deepgnss.io.recording import Recording
from deepgnss.receiver.acquisition import Acquisition
from deepgnss.receiver.signals import GPS_L1CA_SIGNAL

L1 = 1575.42e6
GPS = GPS_L1CA_SIGNAL


def acquisition(prn: int, doppler_hz: float, code_chips: float) -> Acquisition:
    return Acquisition(
        f"G{prn:02d}", prn, 0, doppler_hz, code_chips % 1023.0, 50.0, 10.0, 45.0, True
    )


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("clock_ppm", [0.0, 35.0, -35.0])
def test_code_drift_tells_sense_and_clock(sense: float, clock_ppm: float) -> None:
    seconds = 0.75
    before, after = [], []
    for prn, doppler_hz in ((3, -2500.0), (7, 100.0), (9, 1700.0), (21, 3300.0)):
        code = prn * 97.0
        # a sample clock that is slow by x ppm makes the code look fast by x ppm
        rate = 1.023e6 * (1 + clock_ppm * 1e-6) + sense * doppler_hz / 1540.0
        before.append(acquisition(prn, doppler_hz, code))
        after.append(acquisition(prn, doppler_hz, code + rate * seconds))
    drift = code_drift(before, after, GPS, seconds)
    assert drift is not None
    assert drift.ratio == pytest.approx(sense, abs=1e-6)
    assert drift.clock_ppm == pytest.approx(clock_ppm, abs=1e-6)
    assert 0.0 < drift.sigma < 0.3


def test_code_drift_needs_three_satellites() -> None:
    few = [acquisition(1, 0.0, 0.0), acquisition(2, 9.0, 0.0)]
    assert code_drift(few, few, GPS, 1.0) is None


@pytest.mark.parametrize("rate_hz", [2.6e6, 4.092e6, 16.368e6])
def test_repetition_of_codes_gives_the_rate(rate_hz: float) -> None:
    rng = np.random.default_rng(2)
    n = 1 << 20
    t = np.arange(n) / rate_hz
    z = rng.normal(size=n) + 1j * rng.normal(size=n)
    for prn, doppler_hz in ((1, 1200.0), (8, -2600.0), (17, 300.0), (30, 3900.0)):
        chips = GPS.primary_code(prn)[np.floor(t * 1.023e6 + prn * 10.3).astype(np.int64) % 1023]
        bits = rng.choice([-1, 1], n)[np.floor(t / 0.02).astype(np.int64)]
        z += 0.15 * 3 * chips * bits * np.exp(2j * np.pi * doppler_hz * t)
    samples = np.column_stack([z.real, z.imag]) * 20
    wrong = StreamInfo("L1", 5.0e6, L1, 0.0, True, n)
    block = SampleBlock(wrong, 0, samples.round().clip(-127, 127).astype(np.int8))
    assert repetition_rate_hz(block) == pytest.approx(rate_hz, rel=2e-4)


def test_noise_repeats_nothing() -> None:
    rng = np.random.default_rng(4)
    samples = (20 * rng.normal(size=(1 << 19, 2))).round().astype(np.int8)
    assert (
        repetition_rate_hz(SampleBlock(StreamInfo("x", 4e6, L1, 0, True, 1 << 19), 0, samples))
        is None
    )


def test_signals_within_a_stream() -> None:
    def names(rate_hz: float, centre_hz: float, intermediate_hz: float) -> list[str]:
        stream = StreamInfo("x", rate_hz, centre_hz, intermediate_hz, True, 1)
        return [signal.id.name for signal in signals_within(stream)]

    assert "GPS_L1CA" in names(4e6, L1, 0.0)
    assert "GPS_L1CA" in names(62e6, 1568e6, 0.0)
    assert "GPS_L1CA" not in names(4e6, 1176.45e6, 0.0)
    assert "GPS_L1CA" not in names(4e6, 1561.098e6, 0.0)


# --- real recordings -----------------------------------------------------------------------------


def look(path: Path, number: str, rate_hz: float, **keys: object) -> Survey:
    stream = StreamFormat("L1", number, "iq", rate_hz, L1, **keys)  # type: ignore[arg-type]
    with Recording([stream], path) as recording:
        return survey(lambda first, count: recording.read(0, first, count), GPS)


def test_drive_is_found_upright(shared_data: Path) -> None:
    found = look(shared_data / "independent/drive/rec.bin", "bits1", 2.6e6)
    assert {"G07", "G21", "G01", "G30", "G08"} <= {one.satellite for one in found.found}
    assert found.findings == ()
    assert found.drift is not None
    assert found.drift.ratio == pytest.approx(1.0, abs=5 * found.drift.sigma)
    assert abs(found.drift.clock_ppm) < 0.1  # simulated without clock error


def test_swapped_iq_is_told_by_code_drift(shared_data: Path) -> None:
    path = shared_data / "real/if/pocketsdr/L1_20211202_084700_4MHz_IQ.bin"
    wrong = look(path, "int8", 4e6)
    assert len(wrong.found) >= 5
    assert any("inverted" in text for text in wrong.findings)
    right = look(path, "int8", 4e6, spectrum="inverted")
    assert right.findings == ()


@pytest.mark.parametrize(
    ("keys", "word"),
    [({"rate_hz": 4e6}, "2600000 Hz"), ({"rate_hz": 2.6e6, "intermediate_hz": 5e5}, "at 0")],
)
def test_wrong_rate_and_if_are_said(shared_data: Path, keys: dict[str, float], word: str) -> None:
    found = look(shared_data / "independent/drive/rec.bin", "bits1", **keys)
    assert found.found == ()
    assert any(word in text for text in found.findings)


@pytest.mark.slow
def test_wrong_if_sign_is_said(shared_data: Path) -> None:
    path = shared_data / "real/if/ion-metadata/20170911_1118Z.dat"
    stream = StreamFormat("L1", "int16", "iq", 5e6, L1 + 100e3, 0.0)
    with Recording([stream], path) as recording:
        info = recording.streams[0]
        block = recording.read(0, 0, 200_000)

    def read(first: int, count: int) -> SampleBlock:
        # the same samples described with the centre 100 kHz off, as if the IF were −100 kHz
        wrong = replace(info, centre_hz=L1, intermediate_hz=100e3, sample_count=200_000)
        z = block.samples[first : first + count].astype(float) @ [1, 1j]
        z *= np.exp(-2j * np.pi * 100e3 / 5e6 * np.arange(first, first + count))
        return SampleBlock(wrong, first, np.column_stack([z.real, z.imag]).round().astype(np.int16))

    found = survey(read, GPS)
    assert found.found == ()
    assert any("wrong sign" in text for text in found.findings)


def test_far_oscillator_is_said(shared_data: Path) -> None:
    path = shared_data / "real/if/gnss-sdr/GSoC_CTTC_capture_2012_07_26_4Msps_4ms.dat"
    found = look(path, "float32", 4e6)
    assert {"G29", "G25", "G31"} <= {one.satellite for one in found.found}
    assert any("Dopplers centre on" in text for text in found.findings)
