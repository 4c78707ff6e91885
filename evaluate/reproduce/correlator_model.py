"""Correlations by theory in place of samples: minutes of a channel within seconds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from deepgnss.core.records import ComplexArray, FloatArray, NcoCommand, RunningSums
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.modes import TrackingSettings
from deepgnss.receiver.signals import GPS_L1CA_SIGNAL, Signal

RATE_HZ = 4e6
PHASE_0, CODE_0 = 0.3, 0.0  # cycles and chips at sample 0


@dataclass
class Model:
    """A satellite: its Doppler and C/N0 over time, in unit noise per code period."""

    cn0_dbhz: Callable[[float], float]
    doppler_hz: float = 1234.5
    rate_hzps: float = 0.0
    seed: int = 1
    signal: Signal = GPS_L1CA_SIGNAL
    period_shift: int = 7  # symbols start at code periods 7, 27, …
    clock_cycles: Callable[[FloatArray], FloatArray] | None = None
    jump: tuple[float, float] = (0.0, 0.0)  # second from which the Doppler is higher by Hz
    symbols: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self._generator = np.random.default_rng(self.seed)
        self.symbols = self._generator.choice((-1.0, 1.0), 200_000)

    def phase_cycles(self, t: FloatArray) -> FloatArray:
        """Carrier at seconds since sample 0, running at +Doppler."""
        clock = self.clock_cycles(t) if self.clock_cycles else 0.0
        jumped = self.jump[1] * np.maximum(t - self.jump[0], 0.0)
        steady = PHASE_0 + t * (self.doppler_hz + 0.5 * t * self.rate_hzps)
        return np.asarray(steady + jumped + clock)

    def doppler_at_hz(self, t: FloatArray) -> FloatArray:
        """Doppler without the clock's part."""
        jumped = np.where(t > self.jump[0], self.jump[1], 0.0)
        return np.asarray(self.doppler_hz + t * self.rate_hzps + jumped)

    def code_chips(self, t: FloatArray) -> FloatArray:
        """Since sample 0, whole periods included."""
        carried = (self.phase_cycles(t) - PHASE_0) / self.signal.carrier_to_code
        return np.asarray(CODE_0 + t * self.signal.id.chip_rate_hz + carried)

    def __call__(
        self,
        _sums: RunningSums,
        command: NcoCommand,
        _runs: object,
        taps: FloatArray,
        count: int,
        skip: int = 0,
    ) -> ComplexArray:
        """As `baseband.correlate`."""
        length = self.signal.id.code_chips
        local_chips = (skip + np.arange(count) + 0.5) * length
        s = (local_chips - command.code_chips) / command.code_hz
        s -= 0.5 * command.code_hzps * s * s / command.code_hz
        t = np.asarray(command.sample / RATE_HZ + s, dtype=np.float64)
        turn = self.phase_cycles(t) - command.carrier_cycles
        turn -= s * (command.carrier_hz + 0.5 * s * command.carrier_hzps)
        off_hz = self.doppler_at_hz(t) - command.carrier_hz
        chips = self.code_chips(t)
        period = np.round(chips / length - 0.5).astype(np.int64)
        delay = chips - (period + 0.5) * length
        size = self.signal.symbol_periods
        sign = self.symbols[(period - self.period_shift) // size + 1]
        sign = sign * self.signal.secondary[(period - self.period_shift) % size]
        period_s = self.signal.period_s
        amplitude = np.sqrt(10.0 ** (0.1 * self.cn0_dbhz(float(t[0]))) * period_s)
        amplitude = amplitude * sign * np.sinc(off_hz * period_s)
        tone = amplitude * np.exp(2j * np.pi * turn)
        shape = np.maximum(0.0, 1.0 - np.abs(delay[:, np.newaxis] - taps))
        between = np.maximum(0.0, 1.0 - np.abs(taps[:, np.newaxis] - taps))
        noise = self._generator.standard_normal((count, 2 * taps.size)).view(np.complex128)
        mixed = noise @ np.linalg.cholesky(between).T / np.sqrt(2.0)
        return np.asarray(tone[:, np.newaxis] * shape + mixed)


def start(
    model: Model,
    settings: TrackingSettings,
    *,
    doppler_error_hz: float = 0.0,
    code_error_chips: float = 0.0,
    prn: int | None = None,
) -> Channel:
    """A channel on the model's signal, a little after sample 0."""
    chips = float(model.code_chips(np.array([0.001]))[0])
    return Channel(
        model.signal,
        prn or model.signal.prns[0],
        settings,
        sample_rate_hz=RATE_HZ,
        sample=round(0.001 * RATE_HZ),
        code_chips=(chips + code_error_chips) % model.signal.id.code_chips,
        doppler_hz=model.doppler_hz + doppler_error_hz,
        correlator=model,
    )


def run(
    channel: Channel,
    end_s: float,
    seen: Callable[[Channel], Any] | None = None,
    epoch_s: float = 0.1,
) -> list[Any]:
    """Run a channel up to a time, epoch by epoch; what `seen` made of it after each."""
    found: list[Any] = []
    t = channel.command.sample / RATE_HZ
    while t < end_s:
        t = min(t + epoch_s, end_s)
        channel.begin_epoch()
        channel.run(cast(RunningSums, SimpleNamespace(end=round(t * RATE_HZ))))
        if seen is not None:
            found.append(seen(channel))
    return found
