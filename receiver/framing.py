"""From a channel's symbols to navigation data: frame sync, polarity, transmit time, messages."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.records import Ephemeris, NavData
from deepgnss.core.time import GpsTime
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.known_symbols import KnownSymbols
from deepgnss.receiver.messages import Frame, News, Subframe
from deepgnss.receiver.orbits import with_ephemeris

_SCAN_EVERY = 10  # symbols between searches for a frame
_POLARITY_SYMBOLS = 16  # compared at least with symbols known before
_POLARITY_SHARE = 0.95  # that must agree (or all disagree)


@dataclass(frozen=True, slots=True)
class FrameState:
    """Where the frames of one channel stand."""

    satellite: str
    messages: Any = None  # what the signal's message format has collected, None: nothing yet
    stretch: int = -1  # symbols_first of the stretch of symbols this belongs to
    scanned: int = 0  # symbols searched so far
    next_frame: int | None = None  # index of the first symbol of the next subframe
    heads: int = 0  # frames seen in this stretch


@dataclass(frozen=True, slots=True)
class Found:
    """What an epoch's symbols told."""

    state: FrameState
    heads: tuple[Frame, ...] = ()
    news: tuple[News, ...] = ()
    subframes: tuple[Subframe, ...] = field(default_factory=tuple)


def start(satellite: str) -> FrameState:
    """State of a channel without frames."""
    return FrameState(satellite)


def resume(state: FrameState) -> FrameState:
    """State for a satellite's next channel: its pages so far, but symbols counted anew."""
    return FrameState(state.satellite, state.messages)


def due(state: FrameState, channel: Channel) -> bool:
    """Whether the channel has decided enough since the last look to be read again."""
    count, message = len(channel.symbols), channel.signal.message
    fresh = state.stretch != channel.symbols_first
    if fresh or state.next_frame is None:
        return count - (0 if fresh else state.scanned) >= message.head_symbols + _SCAN_EVERY
    return count >= state.next_frame + message.subframe_symbols


def read_symbols(state: FrameState, channel: Channel, near: GpsTime | None) -> Found:
    """Look at what the channel has decided since the last call."""
    if state.stretch != channel.symbols_first:
        state = replace(state, stretch=channel.symbols_first, scanned=0, next_frame=None, heads=0)
    if not due(state, channel):
        return Found(state)
    count, message = len(channel.symbols), channel.signal.message
    bits = np.frombuffer(bytes(channel.symbols), dtype=np.int8)
    first = state.scanned if state.next_frame is None else state.next_frame
    frames = message.find_frames(bits, first)
    messages = state.messages or message.start(state.satellite)
    news: list[News] = []
    subframes = []
    next_frame = None
    for frame in frames:
        if frame.subframe is not None:
            subframes.append(frame.subframe)
            messages, new = message.collect(messages, frame.subframe, near)
            news.extend(new)
            next_frame = frame.first + message.subframe_symbols
        elif bits.size < frame.first + message.subframe_symbols:
            next_frame = frame.first
            break
    scanned = max(state.scanned, count - message.head_symbols - _SCAN_EVERY + 1)
    state = replace(
        state,
        messages=messages,
        scanned=scanned,
        next_frame=next_frame,
        heads=state.heads + len(frames),
    )
    return Found(state, tuple(frames), tuple(news), tuple(subframes))


def known_symbols(channel: Channel) -> KnownSymbols | None:
    """What a channel has decided in its present stretch, once time and polarity are known."""
    if channel.anchor is None or channel.half_cycle is None or not channel.symbols:
        return None
    inverted = int(channel.half_cycle != 0.0)
    upright = bytes(symbol ^ inverted for symbol in channel.symbols)
    return KnownSymbols(channel.anchor + channel.symbols_first, upright)


def polarity(channel: Channel, known: KnownSymbols, least: int = _POLARITY_SYMBOLS) -> float | None:
    """Half cycle (0 or ½) of a channel from symbols known before; None while too few overlap."""
    if channel.anchor is None:
        return None
    size = channel.signal.symbol_periods
    offset = (channel.anchor + channel.symbols_first - known.first) // size
    seen = np.frombuffer(bytes(channel.symbols), dtype=np.int8)[max(0, -offset) :]
    told = np.frombuffer(known.symbols, dtype=np.int8)[max(0, offset) :]
    count = min(seen.size, told.size)
    if count < least:
        return None
    share = float(np.mean(seen[:count] == told[:count]))
    if share > _POLARITY_SHARE:
        return 0.0
    return 0.5 if share < 1.0 - _POLARITY_SHARE else None


def anchor_of(channel: Channel, frame: Frame, week: int) -> int:
    """Code periods since the GPS epoch at the channel's period 0, from a frame's start time."""
    periods_per_second = round(1.0 / channel.signal.period_s)
    sent = week * SECONDS_PER_WEEK * periods_per_second + round(
        frame.start_tow_s * periods_per_second
    )
    return sent - (channel.symbols_first + frame.first * channel.signal.symbol_periods)


def take_news(nav: NavData, news: tuple[News, ...]) -> NavData:
    """Navigation data with what was just decoded."""
    for item in news:
        if isinstance(item, Ephemeris):
            nav = with_ephemeris(nav, item)
            continue
        if item.klobuchar is not None:
            nav = replace(nav, klobuchar={**nav.klobuchar, item.system: item.klobuchar})
        if item.utc is not None:
            nav = replace(nav, utc=item.utc)
    return nav
