"""Real captures of others, read with plain numpy: samples, rate, IF and the satellites listed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.records import SampleBlock, StreamInfo
from deepgnss.receiver.acquisition import AcquisitionSettings

Samples = NDArray[np.int8] | NDArray[np.int16]


def int8_real(path: Path) -> Samples:
    return np.fromfile(path, np.int8)


def int8_inverted(path: Path) -> Samples:
    """I − jQ."""
    return np.fromfile(path, np.int8).reshape(-1, 2) * np.array([1, -1], np.int8)


def int16_iq(path: Path) -> Samples:
    return np.fromfile(path, "<i2").reshape(-1, 2)


def complex64(path: Path) -> Samples:
    wave = np.fromfile(path, np.complex64)
    values = np.column_stack([wave.real, wave.imag])
    return np.rint(values * (60.0 / values.std())).astype(np.int16)


def two_bits(path: Path) -> Samples:
    """Four real samples a byte, low bits first, codes 0 … 3 → 1, 3, −3, −1."""
    data = np.fromfile(path, np.uint8)
    levels = np.array([1, 3, -3, -1], np.int8)
    return levels[(data[:, np.newaxis] >> np.array([0, 2, 4, 6], np.uint8)) & 3].ravel()


def jrc(path: Path) -> Samples:
    """Q + jI of the top two bits; the first 30 ms, where samples are missing, left out."""
    words = np.fromfile(path, "<u2")[150_000:]
    bits = np.column_stack([words >> 14 & 1, words >> 15])
    return (1 - 2 * bits.astype(np.int8)).astype(np.int8)


def jrc_whole(path: Path) -> Samples:
    words = np.fromfile(path, "<u2")
    bits = np.column_stack([words >> 14 & 1, words >> 15])
    return (1 - 2 * bits.astype(np.int8)).astype(np.int8)


def estec(path: Path) -> Samples:
    """Twelve blocks with headers; four samples a word, L1 signs in the upper half nibble."""
    words = np.fromfile(path, np.uint8).reshape(12, -1)[:, 512:].ravel().view("<u2")
    nibbles = (words[:, np.newaxis] >> np.array([12, 8, 4, 0], np.uint16) & 15).ravel()
    return (1 - 2 * np.column_stack([nibbles >> 3 & 1, nibbles >> 2 & 1]).astype(np.int8)).astype(
        np.int8
    )


@dataclass(frozen=True)
class Capture:
    path: str
    read: Callable[[Path], Samples]
    rate_hz: float
    intermediate_hz: float
    listed: tuple[int, ...]  # GPS satellites of the data's README
    settings: AcquisitionSettings = field(default_factory=AcquisitionSettings)

    def stream(self, shared: Path) -> tuple[StreamInfo, Samples]:
        samples = self.read(shared / "real" / "if" / self.path)
        info = StreamInfo(
            "L1",
            self.rate_hz,
            1_575.42e6,
            self.intermediate_hz,
            samples.ndim == 2,
            len(samples),
        )
        return info, samples

    def block(self, shared: Path) -> SampleBlock:
        info, samples = self.stream(shared)
        return SampleBlock(info, 0, samples)


_IFEN = "ion-metadata/SX3_AltBOC_DualRF_Band{}_f1575420000.stream"
_IFEN_LISTED = (3, 32, 1, 17, 19, 23, 11, 31, 22, 6, 9, 12, 14)
_FIVE_MS = AcquisitionSettings(coherent_s=0.005)

CAPTURES = {
    "PocketSDR 4 MHz": Capture(
        "pocketsdr/L1_20211202_084700_4MHz_IQ.bin", int8_inverted, 4e6, 0.0,
        (26, 31, 29, 16, 32, 18, 4),
    ),
    "PocketSDR 12 MHz": Capture(
        "pocketsdr/L1_20211125_004000_12MHz_I.bin", int8_real, 12e6, 3e6,
        (13, 5, 15, 20, 30, 11, 2, 18, 29),
    ),
    "PocketSDR 24 MHz": Capture(
        "pocketsdr/L1_20211201_054600_24MHz_I.bin", int8_real, 24e6, 6e6,
        (32, 25, 12, 10, 31, 29, 23, 24),
    ),
    "aircraft": Capture(
        "iotgnss-flight/sxnsr_test_data_flight.stream", two_bits, 20.48e6, 5_499_998.474,
        (23, 17, 32, 13, 20, 1, 31, 11, 4, 10),
    ),
    "rooftop": Capture(
        "ion-metadata/20170911_1118Z.dat", int16_iq, 5e6, 0.0, (27, 10, 8, 4, 11, 16, 7, 1)
    ),
    "ESTEC": Capture(
        "ion-metadata/estec.dat", estec, 24e6, 420e3,
        (29, 31, 25, 4, 26, 2, 21, 14, 16, 5, 12, 23),
    ),
    "Hanoi": Capture(
        "ion-metadata/150408_125245_UTC.dat", jrc, 5e6, -48_750.0, (30, 1, 7, 11, 4, 28, 17, 3, 9)
    ),
    "IFEN chain 0": Capture(
        _IFEN.format("1_FE0_ANT0"), two_bits, 20e6, 5_000_445.886, _IFEN_LISTED
    ),
    "IFEN chain 1": Capture(
        _IFEN.format("3_FE0_ANT1"), two_bits, 20e6, 5_000_445.886, _IFEN_LISTED
    ),
    "Castelldefels": Capture(
        "gnss-sdr/GSoC_CTTC_capture_2012_07_26_4Msps_4ms.dat", complex64, 4e6, 0.0,
        (29, 25, 31, 12, 2),
        AcquisitionSettings(doppler_centre_hz=9500.0, coherent_s=0.002),
    ),
    "simulated, without noise": Capture(
        "gnss-sdr/GPS_L1_CA_ID_1_Fs_4Msps_2ms.dat", complex64, 4e6, 0.0, (1,),
        AcquisitionSettings(coherent_s=0.001),
    ),
    "peregrine": Capture(
        "short/peregrine_test_samples_16368_if4092_int8.dat", int8_real, 16.368e6, 4.092e6,
        (15, 2, 9, 24, 29, 5), _FIVE_MS,
    ),
    "RTL-SDR": Capture(
        "short/iivqum_10ms_4MHz_cf32.iq", complex64, 4e6, 0.0, (32, 12, 25, 31, 11, 22, 2), _FIVE_MS
    ),
}  # fmt: skip
