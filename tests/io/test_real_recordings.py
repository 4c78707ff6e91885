"""Recordings none of us wrote, read and searched with plain numpy for satellites known to be there.

The satellites, Dopplers and formats are those listed in the data's own README.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from deepgnss.core.records import SampleBlock
from deepgnss.io.formats import Packing, RecordingDescription, StreamFormat
from deepgnss.io.metadata import describe
from deepgnss.io.recording import Recording
from deepgnss.io.snappergps import read_snapshots

L1 = 1575.42e6
CHIP_RATE = 1.023e6

# IS-GPS-200 table 3-Ia: delay of G2 in chips
G2_DELAY = dict(
    enumerate(
        (5, 6, 7, 8, 17, 18, 139, 140, 141, 251, 252, 254, 255, 256, 257, 258, 469, 470, 471, 472)
        + (473, 474, 509, 512, 513, 514, 515, 516, 859, 860, 861, 862),
        start=1,
    )
)


class Found(NamedTuple):
    ratio: float  # peak over the second peak elsewhere
    doppler_hz: float
    code_samples: float  # delay of the code


def register(taps: tuple[int, ...]) -> np.ndarray:
    state, out = [1] * 10, []
    for _ in range(1023):
        out.append(state[9])
        state = [sum(state[t - 1] for t in taps) % 2, *state[:9]]
    return np.array(out)


def ca_code(prn: int) -> np.ndarray:
    g1, g2 = register((3, 10)), register((2, 3, 6, 8, 9, 10))
    return 1.0 - 2.0 * (g1 ^ np.roll(g2, G2_DELAY[prn]))


def search(block: SampleBlock, prn: int, span_hz: float = 6e3) -> Found:
    """1 ms coherent, non-coherent sum over the whole milliseconds of a block."""
    info, samples = block.stream, block.samples.astype(float)
    z = samples[:, 0] + 1j * samples[:, 1] if info.is_complex else samples
    n = round(info.sample_rate_hz * 1e-3)
    periods = len(z) // n
    t = np.arange(periods * n) / info.sample_rate_hz
    base = z[: periods * n] * np.exp(-2j * np.pi * (info.intermediate_hz + L1 - info.centre_hz) * t)
    chips = np.floor(np.arange(n) * CHIP_RATE / info.sample_rate_hz).astype(int) % 1023
    local = np.conj(np.fft.fft(ca_code(prn)[chips]))
    dopplers = np.arange(-span_hz, span_hz + 1, 250.0)
    power = np.zeros((dopplers.size, n))
    for row, doppler_hz in zip(power, dopplers, strict=True):
        spectra = np.fft.fft((base * np.exp(-2j * np.pi * doppler_hz * t)).reshape(periods, n))
        row += np.sum(np.abs(np.fft.ifft(spectra * local)) ** 2, axis=0)
    best, delay = np.unravel_index(np.argmax(power), power.shape)
    away = (
        np.abs((np.arange(n) - delay + n // 2) % n - n // 2) > 2 * info.sample_rate_hz / CHIP_RATE
    )
    return Found(power.max() / power[:, away].max(), float(dopplers[best]), float(delay))


def read(
    description: RecordingDescription | tuple[StreamFormat, ...],
    path: Path,
    stream: int,
    first: int,
    seconds: float,
) -> SampleBlock:
    formats = description if isinstance(description, tuple) else description.streams
    with Recording(formats, path) as recording:
        info = recording.streams[stream]
        count = min(round(seconds * info.sample_rate_hz), info.sample_count - first)
        return recording.read(stream, first, count)


def bare(
    number: str, samples: str, rate: float, intermediate: float = 0.0, **keys: object
) -> tuple[StreamFormat, ...]:
    return (StreamFormat("L1", number, samples, rate, L1, intermediate, **keys),)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def ion(shared_data: Path) -> Path:
    return shared_data / "real" / "if" / "ion-metadata"


def test_ion_codc(ion: Path) -> None:
    description = describe(ion / "20170911_1118Z.sdrx")
    assert description is not None
    (stream,) = description.streams
    assert (stream.format, stream.samples, stream.sample_rate_hz) == ("int16", "iq", 5e6)
    assert description.start == datetime(2017, 9, 11, 11, 18, tzinfo=UTC)
    block = read(description, ion, 0, 0, 0.01)
    assert block.stream.sample_count == 1_000_000
    assert search(block, 27).ratio > 10
    assert describe(ion / "20170911_1118Z.dat") == description  # found beside the samples


def test_ion_estec_skips_headers_and_splits_nibbles(ion: Path) -> None:
    description = describe(ion / "estec.xml")
    assert description is not None
    l1, l5 = description.streams
    assert l1.block.header == 512
    assert l1.block.payload == 131_072
    assert (l1.intermediate_hz, l5.intermediate_hz) == (420e3, 450e3)
    assert (l1.centre_hz, l5.centre_hz) == (L1, 1176.45e6)
    # across the first block's end (sample 262144): continuous, or the code would jump
    block = read(description, ion, 0, 262_144 - 96_000, 0.008)
    assert set(np.unique(block.samples)) == {-1, 1}
    halves = [
        search(SampleBlock(block.stream, 0, block.samples[k : k + 96_000]), 31) for k in (0, 96_000)
    ]
    assert search(block, 31).ratio > 5
    assert search(block, 29).ratio > 5
    assert abs(halves[0].code_samples - halves[1].code_samples) <= 1
    with Recording(description.streams, ion) as recording:
        assert recording.streams[0].sample_count == 12 * 262_144
        assert recording.notes == ()


def test_ion_jrc_is_q_plus_ji(ion: Path) -> None:
    description = describe(ion / "150408_125245_UTC.xml")
    assert description is not None
    l1, l2, l5 = description.streams
    assert [s.packing.field for s in (l1, l2, l5)] == [(14, 2), (12, 2), (0, 12)]
    assert [s.sample_rate_hz for s in (l1, l2, l5)] == [5e6, 5e6, 30e6]
    assert l1.iq_order == "qi"
    assert l1.intermediate_hz == pytest.approx(-48_750.0, abs=1e-3)
    block = read(description, ion, 0, 150_000, 0.02)
    words = np.fromfile(ion / "150408_125245_UTC.dat", "<u2")[150_000:250_000]
    np.testing.assert_array_equal(block.samples[:, 0], 1 - 2 * (words.astype(int) >> 14 & 1))
    np.testing.assert_array_equal(block.samples[:, 1], 1 - 2 * (words.astype(int) >> 15))
    found = search(block, 30)
    assert found.ratio > 10
    assert search(block, 1).ratio > 10
    straight = replace(l1, iq_order="iq")
    assert search(read((straight,), ion, 0, 150_000, 0.02), 30).ratio < 1.5


def test_ion_ifen_two_chains_on_one_antenna(ion: Path) -> None:
    description = describe(ion / "SX3_AltBOC_DualRF.smfx")
    assert description is not None
    assert [s.name for s in description.streams] == ["ANT0-E1L1", "ANT1-E1L1"]
    assert description.start == datetime(2016, 1, 19, 9, 0, tzinfo=UTC)
    assert sum("not there" in note for note in description.notes) == 2
    found = []
    for chain in (0, 1):
        block = read(description, ion, chain, 0, 0.02)
        assert block.stream.sample_rate_hz == 20e6
        assert block.stream.intermediate_hz == pytest.approx(5_000_445.886, abs=1e-3)
        assert set(np.unique(block.samples)) == {-3, -1, 1, 3}
        found.append(search(block, 3, 4e3))
    assert min(f.ratio for f in found) > 10
    assert abs(found[0].code_samples - found[1].code_samples) <= 0.1 * 20e6 / CHIP_RATE


def test_pocketsdr_inverted_iq(shared_data: Path) -> None:
    path = shared_data / "real/if/pocketsdr/L1_20211202_084700_4MHz_IQ.bin"
    block = read(bare("int8", "iq", 4e6, spectrum="inverted"), path, 0, 0, 0.02)
    for prn, doppler_hz in {26: 700, 31: -200, 29: -2200, 16: 2600, 32: -3300}.items():
        found = search(block, prn)
        assert found.ratio > 2
        assert found.doppler_hz == pytest.approx(doppler_hz, abs=250)


@pytest.mark.parametrize(
    ("name", "stream", "prn", "ratio"),
    [
        ("pocketsdr/L1_20211125_004000_12MHz_I.bin", bare("int8", "real", 12e6, 3e6), 13, 3),
        ("pocketsdr/L1_20211201_054600_24MHz_I.bin", bare("int8", "real", 24e6, 6e6), 32, 5),
        (
            "short/peregrine_test_samples_16368_if4092_int8.dat",
            bare("int8", "real", 16.368e6, 4.092e6), 15, 5,
        ),
        ("short/iivqum_10ms_4MHz_cf32.iq", bare("float32", "iq", 4e6), 32, 2),
        ("gnss-sdr/GPS_L1_CA_ID_1_Fs_4Msps_2ms.dat", bare("float32", "iq", 4e6), 1, 10),
        (
            "iotgnss-flight/sxnsr_test_data_flight.stream",
            bare("bits2", "real", 20.48e6, 5_499_998.474,
                 packing=Packing("lsb_first", "levels", (1, 3, -3, -1))),
            23, 5,
        ),
    ],
)  # fmt: skip
def test_strongest_satellite(
    shared_data: Path, name: str, stream: tuple[StreamFormat, ...], prn: int, ratio: float
) -> None:
    block = read(stream, shared_data / "real/if" / name, 0, 0, 0.01)
    assert search(block, prn).ratio > ratio


def test_float_capture_with_a_far_oscillator(shared_data: Path) -> None:
    path = shared_data / "real/if/gnss-sdr/GSoC_CTTC_capture_2012_07_26_4Msps_4ms.dat"
    found = search(read(bare("float32", "iq", 4e6), path, 0, 0, 1.0), 29, 14e3)
    assert found.ratio > 2
    assert 7e3 <= found.doppler_hz <= 12e3


@pytest.mark.parametrize(
    ("folder", "name", "seconds"), [("drive", "rec.bin", 59.9), ("dual", "l1.bin", 41.0)]
)
def test_one_bit_recordings_are_whole(
    shared_data: Path, folder: str, name: str, seconds: float
) -> None:
    path = shared_data / "independent" / folder / name
    formats = bare("bits1", "iq", 2.6e6)
    with Recording(formats, path) as recording:
        assert recording.streams[0].sample_count == round(seconds * 2.6e6)
        block = recording.read(0, 2_600_000, 52_000)
    ratios = {prn: search(block, prn).ratio for prn in (1, 3, 10, 13, 23, 31, 32)}
    assert sum(ratio > 2 for ratio in ratios.values()) >= 1, ratios


def test_snapper_snapshots(shared_data: Path) -> None:
    snapshots = list(read_snapshots(shared_data / "real/if/snappergps/snapshots/w00.json"))
    assert len(snapshots) == 301
    assert snapshots[0].time == datetime(2021, 11, 22, 12, 40, tzinfo=UTC)
    assert snapshots[0].temperature_c == 7.0
    assert (snapshots[300].time - snapshots[0].time).total_seconds() == pytest.approx(300, abs=1)
    block = snapshots[0].block
    assert block.samples.shape == (49_104,)
    assert block.samples.dtype == np.int8
    assert set(np.unique(block.samples)) == {-1, 1}
    assert [prn for prn in (5, 7, 13, 30) if search(block, prn).ratio > 2] == [5, 7, 13, 30]
