"""Satellites in noise: samples with known code phase, Doppler, strength and symbol edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deepgnss.core.records import GPS_L1CA, SampleBlock, StreamInfo
from deepgnss.receiver.signals import ca_code

CARRIER_HZ = GPS_L1CA.carrier_hz


@dataclass(frozen=True)
class Sent:
    """One satellite; its code phase is that at sample 0."""

    prn: int
    doppler_hz: float
    code_chips: float
    cn0_dbhz: float
    edge: int | None = None  # code period in which the sign changes, then every 20


def info(rate_hz: float, is_complex: bool = True, intermediate_hz: float = 0.0) -> StreamInfo:
    return StreamInfo("L1", rate_hz, CARRIER_HZ, intermediate_hz, is_complex, 1 << 40)


def sky(
    stream: StreamInfo,
    satellites: Sequence[Sent],
    seconds: float,
    rng: np.random.Generator,
    *,
    one_bit: bool = False,
    extra: np.ndarray | None = None,
) -> SampleBlock:
    """Samples of satellites and white noise; C/N0 counts before quantization."""
    count = round(seconds * stream.sample_rate_hz)
    t = np.arange(count) / stream.sample_rate_hz
    wave = rng.normal(0.0, np.sqrt(0.5), (count, 2)) @ np.array([1.0, 1.0j])
    for one in satellites:
        rate = GPS_L1CA.chip_rate_hz * (1.0 + one.doppler_hz / CARRIER_HZ)
        chips = np.floor(one.code_chips + t * rate).astype(np.int64)
        code = ca_code(one.prn)[chips % 1023].astype(float)
        if one.edge is not None:
            code *= 1.0 - 2.0 * (((chips // 1023 - one.edge) // 20) % 2)
        amplitude = np.sqrt(10.0 ** (one.cn0_dbhz / 10.0) / stream.sample_rate_hz)
        amplitude *= 1.0 if stream.is_complex else np.sqrt(2.0)  # half of it becomes the image
        wave += amplitude * code * np.exp(2j * np.pi * (one.doppler_hz * t + rng.random()))
    if extra is not None:
        wave += extra
    wave *= np.exp(2j * np.pi * stream.intermediate_hz * t)
    scale = 12.0
    if stream.is_complex:
        values = np.column_stack([wave.real, wave.imag]) * scale * np.sqrt(2.0)
    else:
        values = wave.real * scale * np.sqrt(2.0)
    if one_bit:
        return SampleBlock(stream, 0, np.where(values >= 0.0, 1, -1).astype(np.int8))
    return SampleBlock(stream, 0, np.rint(np.clip(values, -127, 127)).astype(np.int8))
