"""Tracking a signal too weak for its phase: windows of symbols, their trackers, false lock.

T 3.2, 5.4.2. A window is an `Accumulated` whose "periods" are symbol-long sums, so that the code
loop works on it as on any other; it is coherent where its symbols were known and stripped.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from deepgnss.core.records import ComplexArray, FloatArray
from deepgnss.receiver.locks import shifted_powers
from deepgnss.receiver.modes import FrequencySettings
from deepgnss.receiver.spectral import (
    Tone,
    early_minus_late_hz,
    fft_tone,
    refinement_hz,
    turned,
    two_stage_hz,
)
from deepgnss.receiver.trackers import Accumulated, Correction, accumulate

_WATCHED_S = 1.6  # of windows that a false lock is judged by
_FAR_RATIO = 15.0  # a line that far above the middle ones, in the mean noise of a window's line
_SHIFT_SIGMAS = 3.0  # by which a shifted sum must be stronger …
_SUSPECT_SIGMAS = 1.5  # … and by which it may be, another window will tell

_TONE_SHARE = 0.4  # of a stripped window's power in its largest line: 0.6 at 18 dB-Hz, noise 0.2

Discriminator = Callable[[ComplexArray, float], Tone]


def _energy(frequency_hz: Callable[[ComplexArray, float], float]) -> Discriminator:
    """An energy discriminator with the phase of its prompt line."""

    def tone(sums: ComplexArray, interval_s: float) -> Tone:
        return Tone(frequency_hz(sums, interval_s), float(np.angle(sums.sum())) / math.tau, 0)

    return tone


_DISCRIMINATORS: Mapping[str, Discriminator] = {
    "fft": fft_tone,
    "sfft": fft_tone,
    "early_late": _energy(early_minus_late_hz),
    "refinement": _energy(refinement_hz),
    "two_stage": _energy(two_stage_hz),
}


def always_squares(discriminator: str) -> bool:
    """Whether a discriminator by its name does without known symbols."""
    return discriminator in ("sfft", "psfft")


@dataclass(frozen=True, slots=True)
class SpectralLock:
    """Frequency lock on the tone in a window of symbol sums; squares where they have symbols.

    Order 1 with gain 1 puts what it sees straight into the generator, T 3.2.1; order 2 follows a
    steady change of frequency without lag (α-β filter of Benedict and Bordner, 1962).
    """

    discriminate: Discriminator
    order: int = 1
    gain: float = 1.0
    phase: bool = False

    def tone(self, seen: Accumulated) -> Tone:
        """Tone of a window, of its squares where it is not coherent."""
        sums = seen.periods[:, 1]
        if seen.coherent:
            return self.discriminate(sums, seen.period_s)
        double = self.discriminate(sums * sums, seen.period_s)
        return Tone(0.5 * double.frequency_hz, 0.5 * double.phase_cycles, double.peak)

    def correct(self, seen: Accumulated) -> Correction:
        """Frequency, its rate (order 2) and, when wanted, phase."""
        tone = self.tone(seen)
        rate_gain = self.gain**2 / (2.0 - self.gain) if self.order == 2 else 0.0
        return Correction(
            tone.phase_cycles if self.phase else 0.0,
            self.gain * tone.frequency_hz,
            rate_gain / seen.seconds * tone.frequency_hz,
        )

    def unfollowed_hz(self, correction: Correction) -> float:
        """What a correction has left of the frequency seen."""
        return (1.0 / self.gain - 1.0) * correction.frequency

    def straightened(self, seen: Accumulated) -> Accumulated:
        """The window turned to its tone, for a code loop that adds it up coherently."""
        if not seen.coherent:
            return seen
        bins = self.tone(seen).frequency_hz * seen.seconds
        turn = turned(np.ones(seen.periods.shape[0], dtype=np.complex128), bins)
        return accumulate(seen.periods * turn[:, np.newaxis], seen.period_s, coherent=True)


def spectral_lock(settings: FrequencySettings) -> SpectralLock:
    """The carrier tracker of the settings."""
    discriminate = _DISCRIMINATORS.get(
        settings.discriminator, partial(fft_tone, bins=settings.bins)
    )
    return SpectralLock(discriminate, settings.order, settings.gain, settings.phase)


def noise_bandwidth_hz(settings: FrequencySettings) -> float:
    """One-sided noise bandwidth of the frequency it tracks (as if of order 1)."""
    return 0.5 * settings.gain / ((2.0 - settings.gain) * settings.window_s)


def tone_sigma_hz(cn0_dbhz: float, seen: Accumulated) -> float:
    """1σ of a window's frequency, the Cramér–Rao bound of a tone (Rife and Boorstyn 1974).

    Squares of sums of SNR s have the SNR s²/(s + ½) / 4 of a tone twice as fast.
    """
    snr = 10.0 ** (0.1 * cn0_dbhz) * seen.period_s
    snr = snr if seen.coherent else snr * snr / (snr + 0.5)
    return math.sqrt(6.0 / (seen.periods.shape[0] * snr)) / (math.tau * seen.seconds)


def window_of(
    symbols: ComplexArray, symbol_s: float, signs: FloatArray | None, noise: float = 0.0
) -> Accumulated:
    """A window from symbol sums (n, taps), stripped where their signs (n,) are known.

    Signs that leave no tone are not those that were sent, and are not used. `noise`: its power
    in one of the sums.
    """
    if signs is not None:
        stripped = symbols * signs[:, np.newaxis]
        lines = np.abs(np.fft.fft(stripped[:, 1])) ** 2
        if lines.max() > _TONE_SHARE * lines.sum():
            return accumulate(stripped, symbol_s, coherent=True)
    return accumulate(symbols, symbol_s, coherent=False)._replace(noise=noise)


class Glance(NamedTuple):
    """What one window says of lines away from the middle."""

    frequency_hz: float  # of the generator, less its aiding
    powers: FloatArray  # of all lines of the window's squares
    symbols: int
    gain: tuple[float, float]  # sums of what each symbol's power gains when shifted down, up
    square: tuple[float, float]  # and of its squares


class LockWatch:
    """Finds a frequency lock that is off: beyond the few lines searched, or by ± half a symbol.

    The first is looked for among the lines of the last windows, the second in the powers of
    shifted symbols.
    """

    def __init__(self, symbol_s: float, window_s: float, bins: int) -> None:
        """`bins`: lines about the middle where the discriminator finds the tone itself."""
        self.step_hz = 0.5 / symbol_s
        self.suspicious = False  # a shift may be stronger: the signal's power is not to be believed
        self._inside = bins // 2
        self._line_hz = 0.5 / window_s
        self._glances: deque[Glance] = deque(maxlen=max(1, round(_WATCHED_S / window_s)))

    def clear(self) -> None:
        """Start anew: the generator was moved."""
        self._glances.clear()
        self.suspicious = False

    def off_hz(self, prompts: ComplexArray, frequency_hz: float) -> float:
        """How far the generator is to be moved, Hz; 0 while nothing speaks for it.

        Parameters: prompts of whole symbols (n, periods) without their secondary code; the
        generator's frequency less its aiding.
        """
        shifted = shifted_powers(prompts)
        gains = shifted[:, ::2] - shifted[:, 1:2]
        down, up = gains.sum(axis=0).tolist()
        down_square, up_square = (gains * gains).sum(axis=0).tolist()
        sums = prompts.sum(axis=1)
        lines = np.fft.fft(sums * sums)
        self._glances.append(
            Glance(
                frequency_hz,
                lines.real**2 + lines.imag**2,
                sums.size,
                (down, up),
                (down_square, up_square),
            )
        )
        return self._shift_hz() or self._far_hz(frequency_hz)

    def _shift_hz(self) -> float:
        """From the last window, or the last two, …: the generator may have slipped just now."""
        self.suspicious = False
        for side in range(2):
            count, gain, square = 0, 0.0, 0.0
            for glance in reversed(self._glances):
                count += glance.symbols
                gain += glance.gain[side]
                square += glance.square[side]
                if gain <= 0.0:
                    continue
                sigma = math.sqrt(max(square - gain * gain / count, 0.0))  # of the sum
                if gain > _SHIFT_SIGMAS * sigma:
                    return self.step_hz if side else -self.step_hz
                self.suspicious |= gain > _SUSPECT_SIGMAS * sigma
        return 0.0

    def _far_hz(self, frequency_hz: float) -> float:
        """From the lines of several windows, each moved by what the generator has moved since."""
        total = np.zeros(self._glances[-1].powers.size)
        for glance in self._glances:
            lines = round((glance.frequency_hz - frequency_hz) / self._line_hz)
            total += np.roll(glance.powers, lines) if lines else glance.powers
        size, best = total.size, int(total.argmax())
        inside = np.arange(-min(self._inside, size // 2), min(self._inside, size // 2) + 1)
        noise = np.sort(total)[size // 2] / (len(self._glances) - 0.31)  # median of a gamma law
        if total[best] - total[inside].max() <= _FAR_RATIO * noise:
            return 0.0
        return (best - size if 2 * best >= size else best) * self._line_hz
