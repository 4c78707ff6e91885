"""FRAME-20: subframes found at 20 dB-Hz in symbol sums of unknown phase, T 5.4.4.

The symbols are whole messages of nominal constellations, parity and all, with a telemetry message
of each satellite's own. Heads: those of the publication (GPS: the telemetry word, 30 symbols, its
message known from an earlier frame; D1: preamble, reserved bits and the high bits of the second of
week by a clock right to 3 s, 23 symbols), and what this receiver makes of the same knowledge.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from deepgnss.core.records import ComplexArray, Ephemeris, FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.evaluate.reproduce.table import Figure, percent
from deepgnss.evaluate.reproduce.weak_symbols import received
from deepgnss.receiver.beidou_nav import encode_d1
from deepgnss.receiver.frame_sync import (
    SUBFRAME_S,
    SUBFRAME_SYMBOLS,
    Head,
    d1_heads,
    expected_heads,
    find_head,
    lnav_heads,
)
from deepgnss.receiver.lnav import encode_subframe
from deepgnss.receiver.messages import Bits
from deepgnss.receiver.signals import BDS_B1I_D2
from deepgnss.sim.constellation import nominal

_SYMBOL_S = 0.02
_FRAMES = 4  # of a trial: the one searched may begin anywhere in the first, the next follows
_CLOCK_S = 3.0  # what is known of time where the second of week is
_START = GpsTime(2290, 381_600.0)
_ALL_HZ = 25.0  # frequencies that symbol sums tell apart
_NEAR_HZ = 8.0  # what frequency tracking leaves
_LONGEST = 60  # symbols of a head
_GEOSTATIONARY = tuple(f"C{prn:02d}" for prn in BDS_B1I_D2.prns)


class _Method(NamedTuple):
    """A head, and how it is sought."""

    name: str
    heads: Callable[[float | None, int], Sequence[Head]]  # of a start time and a telemetry message
    timed: bool
    span_hz: float
    least: float | None  # share of frames to be found; None: for comparison


class _Message(NamedTuple):
    """A message, when its subframes begin, and by what heads they are sought."""

    name: str
    system: str
    zero_s: float  # GPST at which a week of the system begins
    methods: tuple[_Method, ...]


def _lnav(start_tow_s: float | None, telemetry: int) -> Sequence[Head]:
    return lnav_heads(start_tow_s, telemetry)


def _lnav_by_time(start_tow_s: float | None, telemetry: int) -> Sequence[Head]:
    return lnav_heads(start_tow_s)


def _d1(start_tow_s: float | None, telemetry: int) -> Sequence[Head]:
    return d1_heads(start_tow_s)


def _d1_published(start_tow_s: float | None, telemetry: int) -> Sequence[Head]:
    """23 symbols: without the subframe's number, the checks and the second word."""
    signs = d1_heads(start_tow_s)[0].signs[:26].copy()
    signs[15:18] = 0.0
    return (Head(signs, start_tow_s),)


_MESSAGES = (
    _Message(
        "GPS",
        "G",
        0.0,
        (
            _Method("30 symbols, ±25 Hz", _lnav, False, _ALL_HZ, 0.98),
            _Method("30 symbols, ±8 Hz", _lnav, False, _NEAR_HZ, None),
            _Method("time, no telemetry: 28 symbols", _lnav_by_time, True, _NEAR_HZ, None),
            _Method("time and telemetry: 52 symbols", _lnav, True, _NEAR_HZ, None),
        ),
    ),
    _Message(
        "BDS D1",
        "C",
        14.0,
        (
            _Method("23 symbols, ±25 Hz", _d1_published, True, _ALL_HZ, 0.85),
            _Method("23 symbols, ±8 Hz", _d1_published, True, _NEAR_HZ, None),
            _Method("no time: 15 symbols", _d1, False, _NEAR_HZ, None),
            _Method("time: 46 symbols", _d1, True, _NEAR_HZ, None),
        ),
    ),
)


class _Stretch(NamedTuple):
    """Symbol sums of two subframes and the head of a third, and the truth about them."""

    sums: ComplexArray
    first: int  # symbol at which a subframe begins, below 300
    tow_s: float  # of symbol 0, as the clock has it
    telemetry: int


def _stretch(message: _Message, orbits: Sequence[Ephemeris], rng: np.random.Generator) -> _Stretch:
    ephemeris = orbits[int(rng.integers(len(orbits)))]
    telemetry = int(rng.integers(1 << 16))
    number = int(rng.integers(100_000))
    begin = GpsTime(_START.week, message.zero_s + SUBFRAME_S * number)
    bits = np.concatenate(
        [_encode(message, begin.plus(k * SUBFRAME_S), ephemeris, telemetry) for k in range(_FRAMES)]
    )
    skip = int(rng.integers(SUBFRAME_SYMBOLS))
    signs: FloatArray = 1.0 - 2.0 * bits[skip:][: 2 * SUBFRAME_SYMBOLS + _LONGEST]
    tow_s = begin.tow_s + skip * _SYMBOL_S + rng.uniform(-_CLOCK_S, _CLOCK_S)
    return _Stretch(received(signs, _SYMBOL_S, rng), -skip % SUBFRAME_SYMBOLS, tow_s, telemetry)


def _encode(message: _Message, start: GpsTime, ephemeris: Ephemeris, telemetry: int) -> Bits:
    if message.system == "C":
        return encode_d1(start, ephemeris)
    return encode_subframe(start, int(start.tow_s) // 6 % 5 + 1, ephemeris, telemetry=telemetry)


def _places(message: _Message, method: _Method, stretch: _Stretch) -> tuple[int, int]:
    """Where a head is found in the first frame and in the second."""
    places = []
    for frame in range(2):
        expected = expected_heads(
            partial(_heads_of, method, stretch.telemetry),
            stretch.tow_s + frame * SUBFRAME_S if method.timed else None,
            _CLOCK_S,
            zero_s=message.zero_s,
        )
        sums = stretch.sums[frame * SUBFRAME_SYMBOLS :]
        place = find_head(sums, expected, _SYMBOL_S, method.span_hz)
        places.append(-1 if place is None else place.first)
    return places[0], places[1]


def _heads_of(method: _Method, telemetry: int, start_tow_s: float | None) -> Sequence[Head]:
    return method.heads(start_tow_s, telemetry)


def measure(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """Shares of frames found from one frame, and from two that must agree."""
    trials = 30 if quick else 500
    nav = nominal(_START, 3600.0, "GC")
    figures = []
    for message in _MESSAGES:
        orbits = [
            sets[0]
            for satellite, sets in nav.ephemerides.items()
            if satellite[0] == message.system and satellite not in _GEOSTATIONARY
        ]
        stretches = [
            _stretch(message, orbits, np.random.default_rng([seed, k, len(message.name)]))
            for seed in seeds
            for k in range(trials)
        ]
        for method in message.methods:
            pairs = [_places(message, method, stretch) for stretch in stretches]
            truth = [stretch.first for stretch in stretches]
            single = sum((a == t) + (b == t) for (a, b), t in zip(pairs, truth, strict=True))
            both = sum(a == b == t for (a, b), t in zip(pairs, truth, strict=True))
            wrong = sum(a == b != t for (a, b), t in zip(pairs, truth, strict=True))
            least = method.least
            met = None if least is None else single >= least * 2 * len(pairs) and wrong == 0
            figures.append(
                Figure(
                    f"{message.name}, {method.name}",
                    f"one frame {percent(single, 2 * len(pairs))};"
                    f" two {percent(both, len(pairs))}, {wrong} wrong",
                    met,
                )
            )
    return figures
