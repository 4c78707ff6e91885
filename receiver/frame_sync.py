"""Frame sync of signals too weak to read: a known head found in sums of unknown phase, T 5.4.4.

Symbols of a subframe's head that are known beforehand are multiplied onto the symbol sums and
added up coherently at every residual frequency; the place with the highest sum is the head. What
is known: preamble and reserved bits always; the telemetry message of LNAV from an earlier frame;
time to some seconds gives the second of week, the subframe's number and the checks over them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np
import scipy.fft
from numpy.lib.stride_tricks import sliding_window_view

from deepgnss.core.constants import BDT_MINUS_GPST_S, SECONDS_PER_WEEK
from deepgnss.core.records import ComplexArray, FloatArray
from deepgnss.receiver import beidou_nav, lnav
from deepgnss.receiver.beidou_layout import HEADER_BITS, INFORMATION_BITS
from deepgnss.receiver.messages import Bits

SUBFRAME_SYMBOLS: Final = 300
SUBFRAME_S: Final = 6.0
_HEAD_SYMBOLS: Final = 60  # two words
_WORD_INFORMATION: Final = 48  # of them in D1: 26 and 22 bits
_PADDING: Final = 4  # of the Fourier transform: between its bins no more than 0.2 dB are lost
_SPAN_HZ: Final = 8.0  # what frequency tracking leaves at 20 dB-Hz, with room


class Head(NamedTuple):
    """The beginning of a subframe as far as it is known."""

    signs: FloatArray  # ±1 as sent (bit 0: +1), up to a common sign; 0: not known
    start_tow_s: float | None = None  # satellite time (GPST) at which it begins, if known


class Expected(NamedTuple):
    """A head, and the symbols [first, stop) at which it may begin."""

    head: Head
    first: int
    stop: int


class Place(NamedTuple):
    """The likeliest place of a head."""

    first: int  # symbol it begins at
    head: Head
    frequency_hz: float  # residual, within the span searched
    amplitude: float  # of the coherent sum
    runner_up: float  # amplitude of the next best place


# --- what is known of a head ---------------------------------------------------------------------


def _agreed(variants: Iterable[Bits]) -> FloatArray:
    """Signs of the bits that all variants share, 0 for the others."""
    bits = np.array(list(variants))
    signs = 1.0 - 2.0 * bits[0]
    signs[(bits != bits[0]).any(axis=0)] = 0.0
    return np.asarray(signs[: int(np.flatnonzero(signs)[-1]) + 1])


def lnav_heads(
    start_tow_s: float | None = None, telemetry: int | None = None, flags: int | None = None
) -> tuple[Head, ...]:
    """Possible heads of an LNAV subframe (IS-GPS-200 20.3.3.1, 20.3.3.2).

    Parameters
    ----------
    start_tow_s: satellite time at which it begins, a multiple of 6 s; None: not known.
    telemetry: the 16 bits behind the preamble, as an earlier frame had them.
    flags: alert and anti-spoof flag of the hand-over word, as an earlier frame had them.

    The telemetry word's last bit turns the hand-over word over: where the former is not known,
    the latter may be of either sign against the preamble, which gives two heads.
    """
    first_word = 0x8B << 16 | (telemetry or 0)
    unknown = [1 << k for k in range(16)] if telemetry is None else []
    first = _agreed(lnav.encode_words([first_word ^ flip]) for flip in (0, *unknown))
    if start_tow_s is None:
        return (Head(first),)
    count = round(start_tow_s / SUBFRAME_S)
    second_word = (count + 1) % (SECONDS_PER_WEEK // 6) << 7 | count % 5 + 1 << 2
    if telemetry is None:
        data = 1.0 - 2.0 * np.array([second_word >> shift & 1 for shift in range(23, -1, -1)])
        data[17:19] = data[22:] = 0.0  # the flags, and the bits that serve the parity
        gap = np.zeros(lnav.WORD_BITS - first.size)
        return tuple(
            Head(np.concatenate([first, gap, sign * data[:22]]), start_tow_s)
            for sign in (1.0, -1.0)
        )
    second_word |= (flags or 0) << 5
    flips = (0, *([1 << 5, 1 << 6] if flags is None else []))
    signs = _agreed(lnav.encode_words([first_word, second_word ^ flip]) for flip in flips)
    return (Head(signs, start_tow_s),)


def d1_heads(start_tow_s: float | None = None) -> tuple[Head, ...]:
    """The head of a D1 subframe (BDS-SIS-ICD B1I 5.2.4.1), checks and interleaving included.

    Parameters: start_tow_s, GPST by the satellite's clock at which it begins; None: not known.
    With it 46 of the first 60 symbols are known, without it 15.
    """
    preamble = int("".join(map(str, beidou_nav.PREAMBLE)), 2)
    header = preamble << HEADER_BITS - beidou_nav.PREAMBLE.size
    known = HEADER_BITS
    if start_tow_s is None:
        known -= 3 + 20
    else:
        sow_s = round(start_tow_s + BDT_MINUS_GPST_S) % SECONDS_PER_WEEK
        header |= (sow_s // 6 % 5 + 1) << 20 | sow_s
    information = header << INFORMATION_BITS - HEADER_BITS
    flips = (1 << INFORMATION_BITS - 1 - k for k in range(known, _WORD_INFORMATION))
    signs = _agreed(
        beidou_nav.encode_words(information ^ flip)[:_HEAD_SYMBOLS] for flip in (0, *flips)
    )
    return (Head(signs, start_tow_s),)


def expected_heads(
    heads: Callable[[float | None], Sequence[Head]],
    tow_s: float | None = None,
    half_s: float = SUBFRAME_S / 2.0,
    *,
    symbol_s: float = 0.02,
    zero_s: float = 0.0,
    count: int = SUBFRAME_SYMBOLS,
) -> list[Expected]:
    """Heads that may begin at symbols [0, count), by what is known of time.

    Parameters
    ----------
    heads: possible heads for a start time.
    tow_s: satellite time (GPST, s of week) at which symbol 0 begins, right to ± half_s; None: any.
    zero_s: GPST at which a week of the system begins: 14 for BeiDou.
    """
    if tow_s is None:
        return [Expected(head, 0, count) for head in heads(None)]
    expected = []
    lowest = math.ceil((tow_s - half_s - zero_s) / SUBFRAME_S)
    highest = math.floor((tow_s + half_s + count * symbol_s - zero_s) / SUBFRAME_S)
    for number in range(lowest, highest + 1):
        start_s = zero_s + number * SUBFRAME_S
        first = max(0, math.ceil((start_s - half_s - tow_s) / symbol_s))
        stop = min(count, math.floor((start_s + half_s - tow_s) / symbol_s) + 1)
        if first < stop:
            found = heads(start_s % SECONDS_PER_WEEK)
            expected += [Expected(head, first, stop) for head in found]
    return expected


# --- where it is ---------------------------------------------------------------------------------


def head_amplitudes(
    sums: ComplexArray, signs: FloatArray, symbol_s: float = 0.02, span_hz: float = _SPAN_HZ
) -> tuple[FloatArray, FloatArray]:
    """Highest coherent sum of every place over residual frequency, and that frequency, Hz.

    Parameters: sums (n,) of whole symbols, of any phase. Both results have shape
    (n − signs.size + 1,). T(5.20–5.21), padded so that no frequency falls between two bins.
    """
    bins = scipy.fft.next_fast_len(_PADDING * signs.size)
    frequencies_hz = scipy.fft.fftfreq(bins, symbol_s)
    sought = np.flatnonzero(np.abs(frequencies_hz) <= span_hz)
    spectra = scipy.fft.fft(sliding_window_view(sums, signs.size) * signs, bins)
    power = spectra[:, sought].real ** 2 + spectra[:, sought].imag ** 2
    best = power.argmax(axis=1)
    amplitudes = np.sqrt(power[np.arange(best.size), best])
    return amplitudes, frequencies_hz[sought[best]]


def find_head(
    sums: ComplexArray,
    expected: Sequence[Expected],
    symbol_s: float = 0.02,
    span_hz: float = _SPAN_HZ,
) -> Place | None:
    """The likeliest place of a head in symbol sums (n,); None where the sums are too few.

    One frame's word only: to be believed when another frame says the same (`find_frame`).
    """
    best: tuple[float, float, Expected, int] | None = None
    highest: dict[int, float] = {}
    for one in expected:
        size = one.head.signs.size
        if sums.size < one.stop - 1 + size:
            return None
        amplitudes, frequencies_hz = head_amplitudes(
            sums[one.first : one.stop - 1 + size], one.head.signs, symbol_s, span_hz
        )
        amplitudes = amplitudes / math.sqrt(float(np.abs(one.head.signs).sum()))
        for k, amplitude in enumerate(amplitudes.tolist(), start=one.first):
            highest[k] = max(amplitude, highest.get(k, 0.0))
        top = int(amplitudes.argmax())
        if best is None or amplitudes[top] > best[0]:
            best = float(amplitudes[top]), float(frequencies_hz[top]), one, one.first + top
    if best is None:
        return None
    amplitude, frequency_hz, one, first = best
    runner_up = max((value for k, value in highest.items() if k != first), default=0.0)
    return Place(first, one.head, frequency_hz, amplitude, runner_up)


def find_frame(
    sums: ComplexArray,
    expected: Sequence[Expected],
    expected_next: Sequence[Expected],
    symbol_s: float = 0.02,
    span_hz: float = _SPAN_HZ,
) -> Place | None:
    """A head found in one frame and again in the next, 300 symbols later; else None.

    Parameters: expected heads of the first 300 symbols, and of the next (counted from there on).
    """
    place = find_head(sums, expected, symbol_s, span_hz)
    again = find_head(sums[SUBFRAME_SYMBOLS:], expected_next, symbol_s, span_hz)
    if place is None or again is None or place.first != again.first:
        return None
    return place
