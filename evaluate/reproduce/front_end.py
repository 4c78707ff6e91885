"""What a front end's filter and converter leave of a signal: level and shape of its correlation."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from deepgnss.core.records import GPS_L1CA, FloatArray, SignalId
from deepgnss.receiver.signals import signal_of
from deepgnss.sim.filters import low_pass
from deepgnss.sim.quantization import quantization_loss_db
from deepgnss.sim.scenario import FrontEnd

_SPECTRUM: Final = 8192  # points of the sampled band
_IMAGES: Final = 4  # of it on either side
_FINE: Final = 128  # points per chip of a correlation


def gain(front_end: FrontEnd, frequency_hz: FloatArray) -> FloatArray:
    """Gain of the filter at frequencies off the centre; 1 without one. Complex samples.

    The simulator filters samples: what lay outside the sampled band has gone into it before and
    keeps the gain of its image.
    """
    taps = low_pass(front_end)
    if taps is None:
        return np.ones_like(frequency_hz)
    turns = np.arange(1, taps.size // 2 + 1) / front_end.sample_rate_hz
    half = taps[taps.size // 2 :].astype(np.float64)
    out = np.full(frequency_hz.shape, half[0])
    for turn, tap in zip(turns, half[1:], strict=True):
        out += 2.0 * tap * np.cos(2.0 * np.pi * turn * frequency_hz)
    return out


def _tap(front_end: FrontEnd, frequency_hz: FloatArray) -> FloatArray:
    """Taps off prompt share out samples at chip edges: as if each lasted one sample."""
    return np.sinc(frequency_hz / front_end.sample_rate_hz)


def _spectrum(front_end: FrontEnd, signal: SignalId) -> tuple[FloatArray, FloatArray]:
    """Frequencies over the chip rate, images of the sampled band too; power of a code at each."""
    width = 2 * _IMAGES + 1
    hz = np.linspace(-0.5, 0.5, _SPECTRUM * width + 1) * width * front_end.sample_rate_hz
    chips = hz / signal.chip_rate_hz
    return chips, np.sinc(chips) ** 2 * (chips[1] - chips[0])


def _filter_loss_db(front_end: FrontEnd, signal: SignalId) -> float:
    chips, weight = _spectrum(front_end, signal)
    passed = gain(front_end, chips * signal.chip_rate_hz)
    level, noise = float(weight @ passed), float(weight @ passed**2)
    return 10.0 * math.log10(noise / level**2)


def loss_db(front_end: FrontEnd, signal: SignalId = GPS_L1CA) -> float:
    """C/N0 in front of filter and converter over that behind them, for a replica of whole chips.

    The replica collects ∫S·H of the signal's amplitude and ∫S·H² of the noise, S its spectrum.
    """
    return _filter_loss_db(front_end, signal) + quantization_loss_db(front_end, signal)


def correlation(front_end: FrontEnd, signal: SignalId, prn: int) -> tuple[FloatArray, FloatArray]:
    """Correlation of a filtered periodic code with taps off prompt, ±3 chips: (chips, value)."""
    code = np.repeat(signal_of(signal.name, prn).primary_code(prn).astype(np.float64), _FINE)
    spectrum = np.abs(np.fft.rfft(code)) ** 2
    hz = np.fft.rfftfreq(code.size, 1.0 / (_FINE * signal.chip_rate_hz)).astype(np.float64)
    passed = gain(front_end, hz) * _tap(front_end, hz)
    around = np.fft.irfft(spectrum * passed, code.size) / code.size
    lags = np.arange(-3 * _FINE, 3 * _FINE + 1)
    return lags / _FINE, around[lags]


def code_noise_ratio(front_end: FrontEnd, spacing_chips: float) -> float:
    """σ of an early-minus-late C/A loop behind this front end, over √(B·D / 2 C/N0).

    The integral that T(2.25) stands for, and what it leaves out: the filter ripples the slope at
    the taps, and a loop that expects 2/(2 − D) there is as much wider or narrower than told.
    """
    chips, weight = _spectrum(front_end, GPS_L1CA)
    f_hz = chips * GPS_L1CA.chip_rate_hz
    passed = gain(front_end, f_hz) * _tap(front_end, f_hz)
    turn = np.pi * spacing_chips * chips  # of a tap
    level = float(weight @ (passed * np.cos(turn)))
    steepness = float(weight @ (2.0 * np.pi * chips * passed * np.sin(turn)))
    noise = float(weight @ (2.0 * passed**2 * np.sin(turn) ** 2))  # of early less late, halved
    wider = steepness / level * (1.0 - 0.5 * spacing_chips)
    behind = 10.0 ** (-0.1 * _filter_loss_db(front_end, GPS_L1CA))
    variance = wider * noise / (2.0 * steepness**2) * behind
    return math.sqrt(2.0 * variance / spacing_chips)
