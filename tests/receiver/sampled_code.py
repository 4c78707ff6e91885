"""Sampled C/A signals made from the definitions, and a correlator that goes sample by sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.records import (
    GPS_L1CA,
    ComplexArray,
    FloatArray,
    NcoCommand,
    SampleBlock,
    StreamInfo,
)
from deepgnss.receiver.signals import ca_code

CARRIER_HZ, CHIP_HZ = GPS_L1CA.carrier_hz, GPS_L1CA.chip_rate_hz
CODE_CHIPS = 1023


def stream(
    rate_hz: float,
    *,
    is_complex: bool = True,
    intermediate_hz: float = 0.0,
    centre_hz: float = CARRIER_HZ,
    sample_count: int = 1 << 40,
) -> StreamInfo:
    """A stream with the signal where it is told to be."""
    return StreamInfo("L1", rate_hz, centre_hz, intermediate_hz, is_complex, sample_count)


def signal_command(
    sample: int,
    *,
    doppler_hz: float,
    code_chips: float,
    carrier_cycles: float = 0.0,
    doppler_hzps: float = 0.0,
) -> NcoCommand:
    """Code and carrier of a signal whose code follows its carrier."""
    ratio = CHIP_HZ / CARRIER_HZ
    return NcoCommand(
        sample,
        carrier_cycles,
        doppler_hz,
        doppler_hzps,
        code_chips,
        CHIP_HZ + ratio * doppler_hz,
        ratio * doppler_hzps,
    )


def carrier_cycles(command: NcoCommand, seconds: FloatArray) -> FloatArray:
    """Phase `seconds` after the command."""
    return np.asarray(
        command.carrier_cycles
        + seconds * (command.carrier_hz + 0.5 * seconds * command.carrier_hzps)
    )


def code_chips(command: NcoCommand, seconds: FloatArray) -> FloatArray:
    """Code phase `seconds` after the command, not reduced to a period."""
    return np.asarray(
        command.code_chips + seconds * (command.code_hz + 0.5 * seconds * command.code_hzps)
    )


def sampled(
    info: StreamInfo,
    prn: int,
    command: NcoCommand,
    first: int,
    count: int,
    amplitude: float = 100.0,
) -> SampleBlock:
    """Samples [first, first + count) of one signal without noise, rounded to int8 or int16."""
    n = np.arange(first, first + count)
    seconds = (n - command.sample) / info.sample_rate_hz
    mix_hz = info.intermediate_hz + (CARRIER_HZ - info.centre_hz)
    phase = 2.0 * np.pi * (carrier_cycles(command, seconds) + _turns(mix_hz, info, n))
    chips = np.floor(code_chips(command, seconds)).astype(np.int64)
    wave = amplitude * ca_code(prn)[chips % CODE_CHIPS] * np.exp(1j * phase)
    values = np.column_stack([wave.real, wave.imag]) if info.is_complex else wave.real
    dtype = np.int8 if amplitude < 128.0 else np.int16
    return SampleBlock(info, first, np.rint(values).astype(dtype))


def brute_force(
    block: SampleBlock, prn: int, command: NcoCommand, taps_chips: FloatArray, periods: int
) -> ComplexArray:
    """Correlations (periods, taps), every sample with its own replica chip and carrier.

    The prompt (offset 0) takes the chip at the sample; other taps what their replica is on the
    average over the sample's length, half a sample to either side.
    """
    info = block.stream
    n = block.first + np.arange(block.samples.shape[0])
    seconds = (n - command.sample) / info.sample_rate_hz
    mix_hz = info.intermediate_hz + (CARRIER_HZ - info.centre_hz)
    values = block.samples.astype(np.float64)
    baseband = values[:, 0] + 1j * values[:, 1] if info.is_complex else values + 0j
    turns = np.mod(carrier_cycles(command, seconds), 1.0) + _turns(mix_hz, info, n)
    baseband = baseband * np.exp(-2j * np.pi * turns)
    out = np.empty((periods, taps_chips.size), dtype=np.complex128)
    half_s = 0.5 / info.sample_rate_hz
    for t, offset in enumerate(taps_chips):
        for period in range(periods):
            begin = period * CODE_CHIPS
            if offset == 0.0:
                replica = _chip(prn, code_chips(command, seconds), begin)
            else:
                before = code_chips(command, seconds - half_s) + offset
                after = code_chips(command, seconds + half_s) + offset
                replica = (_area(prn, after, begin) - _area(prn, before, begin)) / (after - before)
            out[period, t] = np.sum(baseband * replica)
    return out


def _turns(mix_hz: float, info: StreamInfo, n: NDArray[np.int64]) -> FloatArray:
    """Phase of the mixer at samples n, cycles; anchored at sample 0."""
    return np.asarray(np.mod(np.mod(mix_hz / info.sample_rate_hz, 1.0) * n, 1.0))


def _chip(prn: int, chips: FloatArray, begin: int) -> FloatArray:
    """Replica of one period only, which begins at chip `begin`."""
    whole = np.floor(chips).astype(np.int64) - begin
    inside = (whole >= 0) & (whole < CODE_CHIPS)
    return np.where(inside, ca_code(prn)[whole % CODE_CHIPS].astype(np.float64), 0.0)


def _area(prn: int, chips: FloatArray, begin: int) -> FloatArray:
    """Integral of that replica from −∞ to `chips`."""
    corners = np.concatenate([[0.0], np.cumsum(ca_code(prn), dtype=np.float64)])
    return np.asarray(np.interp(chips - begin, np.arange(CODE_CHIPS + 1), corners))
