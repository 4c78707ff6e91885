"""BeiDou D1 and D2: words, subframes to ephemerides and back (BDS-SIS-ICD B1I 5.2, 5.3).

D1 (50 bps, MEO and IGSO): frames of 30 s, ephemeris in subframes 1–3. D2 (500 bps, GEO): frames
of 3 s, ephemeris in subframe 1 of ten frames. Times are GPST outside, BDT in the bits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Final

import numpy as np

from deepgnss.core.constants import BDT_MINUS_GPST_S, SECONDS_PER_WEEK
from deepgnss.core.records import Ephemeris, Klobuchar, UtcParameters
from deepgnss.core.time import GpsTime
from deepgnss.receiver import bch
from deepgnss.receiver.beidou_layout import (
    D1_PAGES,
    D2_PAGES,
    FIELDS,
    HEADER_BITS,
    INFORMATION_BITS,
    KLOBUCHAR_FIELDS,
    Layout,
    Page,
    pack,
    unpack,
)
from deepgnss.receiver.lnav import URA_M
from deepgnss.receiver.messages import Bits, Frame, IonoUtc, MessageFormat, News, nearest

SUBFRAME_BITS: Final = 300
WORD_BITS: Final = 30
PREAMBLE: Final = np.array([1, 1, 1, 0, 0, 0, 1, 0, 0, 1, 0], dtype=np.int8)
BDT_WEEK_OFFSET: Final = 1356
"""GPS week of BeiDou week 0."""

_HEAD_BITS: Final = 2 * WORD_BITS
_SOW_BITS: Final = 20
_CYCLE_S: Final = 30.0  # of all pages of an ephemeris, D1 and D2
_SET_S: Final = 3600.0  # sets change on the full hour of BDT
_MOST_CORRECTED: Final = 4  # of 19 code words: a subframe with more of them is not believed

# --- words ---------------------------------------------------------------------------------------


def encode_words(information: int) -> Bits:
    """The 300 transmitted bits of a subframe's information (BDS-SIS-ICD B1I 5.1.3).

    Two code words of 15 bits make a word, bit by bit in turn; only of the first word the first 15
    bits are sent as they are, and the other 15 are one code word.
    """
    bits = np.array([information >> k & 1 for k in range(INFORMATION_BITS - 1, -1, -1)], np.int8)
    codes = bch.encode(bits[15:].reshape(-1, bch.INFORMATION_BITS))
    pairs = codes[1:].reshape(-1, 2, bch.WORD_BITS).transpose(0, 2, 1)
    return np.concatenate([bits[:15], codes[0], pairs.ravel()])


def decode_words(bits: Bits) -> tuple[int, int]:
    """Information of whole words from a subframe's start, upright, and how many code words erred.

    Every code word is brought to the nearest valid one.
    """
    pairs = bits[WORD_BITS:].reshape(-1, bch.WORD_BITS, 2).transpose(0, 2, 1)
    codes = np.vstack([bits[15:WORD_BITS], pairs.reshape(-1, bch.WORD_BITS)])
    nearest_codes, wrong = bch.correct(codes)
    data = np.concatenate([bits[:15], nearest_codes[:, : bch.INFORMATION_BITS].ravel()])
    return int("".join(map(str, data.tolist())), 2), int(wrong.sum())


# --- subframes -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class BeidouSubframe:
    """A subframe with few enough errors to be believed."""

    start_tow_s: float  # GPST of the satellite at which its first bit left
    subframe_id: int
    information: int  # 224 bits
    corrected: int  # code words in which a bit was turned; two wrong bits make that a third one

    @property
    def payload(self) -> int:
        """Information behind the second of week."""
        return self.information & (1 << (INFORMATION_BITS - HEADER_BITS)) - 1


@dataclass(frozen=True, slots=True)
class _Kind:
    """What D1 and D2 differ in."""

    name: str
    subframe_s: float
    pages: Mapping[Page, Layout]
    cycle: Mapping[Page, float]  # pages of an ephemeris and when they start in their common cycle
    klobuchar: Page
    utc: Page

    def start_tow_s(self, sow_s: int, subframe_id: int) -> float:
        """GPST of a subframe; D1 counts seconds at its own start, D2 at its frame's."""
        late_s = 0.0 if self.subframe_s >= 1.0 else (subframe_id - 1) * self.subframe_s
        return (sow_s - BDT_MINUS_GPST_S) % SECONDS_PER_WEEK + late_s

    def page(self, subframe: BeidouSubframe) -> Page | None:
        """The page a subframe is, None for almanacs and the like."""
        number = subframe.subframe_id
        if (number, 0) in self.pages:
            return number, 0
        length = 4 if number == 1 else 8  # the latter with a bit that is reserved
        shown = subframe.payload >> INFORMATION_BITS - HEADER_BITS - length
        page = number, shown & 127
        return page if page in self.pages else None


def _handover(kind: _Kind, head: int) -> tuple[float, int] | None:
    """Start time and number of a subframe from the first 38 bits of its information."""
    subframe_id, sow_s = head >> 20 & 7, head & 0xFFFFF
    if not 1 <= subframe_id <= 5 or sow_s >= SECONDS_PER_WEEK:
        return None
    return kind.start_tow_s(sow_s, subframe_id), subframe_id


def _decode(kind: _Kind, bits: Bits) -> BeidouSubframe | None:
    if not np.array_equal(bits[: PREAMBLE.size], PREAMBLE):
        return None
    information, corrected = decode_words(bits)
    handover = _handover(kind, information >> INFORMATION_BITS - HEADER_BITS)
    if corrected > _MOST_CORRECTED or handover is None:
        return None
    return BeidouSubframe(*handover, information, corrected)


def _find_frames(kind: _Kind, bits: Bits, first: int = 0) -> list[Frame]:
    """All places from index `first` on where a subframe starts, of either polarity.

    Needed: the preamble, and either a subframe with few errors or two words without any that give
    a possible time and number; if the next subframe's two words are there too, they must read as
    its successor.
    """
    if bits.size - first < _HEAD_BITS:
        return []
    windows = np.lib.stride_tricks.sliding_window_view(
        bits[first : bits.size - _HEAD_BITS + PREAMBLE.size], PREAMBLE.size
    )
    hits = (windows == PREAMBLE).sum(axis=1)
    frames = (
        _frame_at(kind, bits, int(k)) for k in np.flatnonzero(hits % PREAMBLE.size == 0) + first
    )
    return [frame for frame in frames if frame is not None]


def _frame_at(kind: _Kind, bits: Bits, first: int) -> Frame | None:
    polarity = int(bits[first] ^ PREAMBLE[0])
    upright = bits[first : first + SUBFRAME_BITS + _HEAD_BITS] ^ polarity
    subframe = _decode(kind, upright[:SUBFRAME_BITS]) if upright.size >= SUBFRAME_BITS else None
    if subframe is not None:
        return Frame(first, polarity, subframe.start_tow_s, subframe.subframe_id, True, subframe)
    head = _clean_head(kind, upright[:_HEAD_BITS])
    if head is None:
        return None
    follows = False
    if upright.size == SUBFRAME_BITS + _HEAD_BITS:
        after = _clean_head(kind, upright[SUBFRAME_BITS:])
        if after is None or after[1] != head[1] % 5 + 1:
            return None
        late_s = (after[0] - head[0] - kind.subframe_s) % SECONDS_PER_WEEK
        if min(late_s, SECONDS_PER_WEEK - late_s) > 0.01:
            return None
        follows = True
    return Frame(first, polarity, *head, follows, None)


def _clean_head(kind: _Kind, bits: Bits) -> tuple[float, int] | None:
    if not np.array_equal(bits[: PREAMBLE.size], PREAMBLE):
        return None
    information, corrected = decode_words(bits)
    return None if corrected else _handover(kind, information >> 48 - HEADER_BITS)


# --- from subframes to records -------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class BeidouState:
    """What was gathered from one satellite."""

    satellite: str
    pages: Mapping[Page, BeidouSubframe] = field(default_factory=dict)
    doubtful: Mapping[Page, int] = field(default_factory=dict)  # payloads with corrected bits
    ephemeris: Ephemeris | None = None
    klobuchar: Klobuchar | None = None
    utc: UtcParameters | None = None


_EPHEMERIS_FIELDS: Final = frozenset(f.name for f in fields(Ephemeris)) & FIELDS.keys()


def _collect(
    kind: _Kind, state: BeidouState, subframe: BeidouSubframe, near: GpsTime | None = None
) -> tuple[BeidouState, tuple[News, ...]]:
    """Take in a subframe; hand out what it completes, if that is new.

    The pages of an ephemeris carry no common issue: they count together when they left in one
    cycle (a frame of D1, ten of D2), within which the set does not change, or in two neighbouring
    ones of one hour (sets change on the hour) that name the same reference time. A subframe with
    corrected bits counts once it has come twice alike.
    """
    page = kind.page(subframe)
    if page is None:
        return state, ()
    if subframe.corrected and state.doubtful.get(page) != subframe.payload:
        known = state.pages.get(page)
        if known is None or known.payload != subframe.payload:
            return replace(state, doubtful={**state.doubtful, page: subframe.payload}), ()
    state = replace(state, pages={**state.pages, page: subframe})
    news: list[News] = []
    if page in kind.cycle:
        ephemeris = _ephemeris(kind, state)
        old = state.ephemeris
        if ephemeris is not None and (
            old is None or replace(old, transmitted=ephemeris.transmitted) != ephemeris
        ):
            state = replace(state, ephemeris=ephemeris)
            news.append(ephemeris)
    if page == kind.klobuchar:
        values = unpack(kind.pages, {page: subframe.information})
        a0, a1, a2, a3, b0, b1, b2, b3 = (values[name] for name in KLOBUCHAR_FIELDS)
        klobuchar = Klobuchar((a0, a1, a2, a3), (b0, b1, b2, b3))
        if klobuchar != state.klobuchar and any(klobuchar.alpha + klobuchar.beta):
            state = replace(state, klobuchar=klobuchar)
            news.append(IonoUtc(klobuchar, None, state.satellite[0]))
    date = state.ephemeris.transmitted if state.ephemeris else near
    if page == kind.utc and date is not None:
        utc = _utc(unpack(kind.pages, {page: subframe.information}), date)
        if utc != state.utc:
            state = replace(state, utc=utc)
            news.append(IonoUtc(None, utc, state.satellite[0]))
    return state, tuple(news)


def _ephemeris(kind: _Kind, state: BeidouState) -> Ephemeris | None:
    if not kind.cycle.keys() <= state.pages.keys():
        return None
    parts = {page: state.pages[page] for page in kind.cycle}
    starts_s = {
        round(part.start_tow_s - kind.cycle[page]) % SECONDS_PER_WEEK
        for page, part in parts.items()
    }
    values = unpack(kind.pages, {page: part.information for page, part in parts.items()})
    sent_s = max(starts_s)
    if len(starts_s) > 1 and (
        sent_s - min(starts_s) > _CYCLE_S
        or len({(start_s + BDT_MINUS_GPST_S) // _SET_S for start_s in starts_s}) > 1
        or values["toe_s"] != values["toc_s"]
    ):
        return None
    # Satellite time is GPST here, the week that of BDT, 14 s behind: it may still be the last one.
    week = BDT_WEEK_OFFSET + int(values["week"]) + (sent_s < -BDT_MINUS_GPST_S)
    transmitted = GpsTime(week, float(sent_s))
    named = {name: values[name] for name in _EPHEMERIS_FIELDS}
    integers = {name: int(values[name]) for name in ("iode", "iodc", "health")}
    return Ephemeris(
        satellite=state.satellite,
        transmitted=transmitted,
        toe=_gpst(values["toe_s"], transmitted),
        toc=_gpst(values["toc_s"], transmitted),
        accuracy_m=URA_M[int(values["ura_index"])],
        **(named | integers),  # type: ignore[arg-type]  # the table names the rest
    )


def _gpst(sow_s: float, near: GpsTime) -> GpsTime:
    return nearest((sow_s - BDT_MINUS_GPST_S) % SECONDS_PER_WEEK, near)


def _utc(values: Mapping[str, float], date: GpsTime) -> UtcParameters:
    """Of BDT; its polynomial counts from the start of the week (5.2.4.19)."""
    now = date.plus(BDT_MINUS_GPST_S).week
    leap_week = BDT_WEEK_OFFSET + int(values["leap_week"])
    return UtcParameters(
        a0_s=values["a0_s"],
        a1_sps=values["a1_sps"],
        reference=GpsTime(now, 0.0).plus(-BDT_MINUS_GPST_S),
        leap_s=int(values["leap_s"] - BDT_MINUS_GPST_S),
        leap_future_s=int(values["leap_future_s"] - BDT_MINUS_GPST_S),
        leap_week=leap_week + 256 * round((now - leap_week) / 256),
        leap_day=int(values["leap_day"]) + 1,  # GPS counts days from 1
    )


# --- from records to subframes -------------------------------------------------------------------


def _encode(
    kind: _Kind,
    start: GpsTime,
    ephemeris: Ephemeris,
    klobuchar: Klobuchar | None,
    utc: UtcParameters | None,
) -> Bits:
    bdt = start.plus(BDT_MINUS_GPST_S)
    count = round(bdt.tow_s / kind.subframe_s)  # subframes since the start of the BDT week
    subframe_id, frame = count % 5 + 1, count // 5
    frame_s = round(5.0 * kind.subframe_s)
    if kind is _D1:
        page = (subframe_id, frame % 24 + 1 if subframe_id > 3 else 0)
        sow_s = round(count * kind.subframe_s)
    else:
        page = (subframe_id, frame % {1: 10, 5: 120}.get(subframe_id, 6) + 1)
        sow_s = frame * frame_s
    values = {**_values(ephemeris, bdt.week), **_page_values(klobuchar, utc), "d2_page": page[1]}
    values["page"] = page[1]
    if page in kind.pages and (page != kind.utc or utc is not None):
        information = pack(kind.pages, page, values)
        if kind is _D2 and subframe_id == 1:  # its last five words are reserved
            information |= int("10" * 55, 2)
    else:
        information = _filler(subframe_id, page[1])
    head = 0x712 << 27 | subframe_id << 20 | sow_s
    return encode_words(head << INFORMATION_BITS - HEADER_BITS | information)


def _filler(subframe_id: int, page: int) -> int:
    """Alternating ones and zeros behind the page number."""
    length = INFORMATION_BITS - HEADER_BITS - 8
    return page << length | int("10" * (length // 2), 2)


def _values(ephemeris: Ephemeris, week: int) -> dict[str, float]:
    named = {name: getattr(ephemeris, name) for name in _EPHEMERIS_FIELDS}
    return named | {
        "week": week - BDT_WEEK_OFFSET,
        "ura_index": next(n for n, m in enumerate(URA_M) if m >= min(ephemeris.accuracy_m, 8192)),
        "toc_s": ephemeris.toc.plus(BDT_MINUS_GPST_S).tow_s,
        "toe_s": ephemeris.toe.plus(BDT_MINUS_GPST_S).tow_s,
    }


def _page_values(klobuchar: Klobuchar | None, utc: UtcParameters | None) -> dict[str, float]:
    coefficients: Sequence[float] = (0.0,) * 8
    if klobuchar is not None:
        coefficients = klobuchar.alpha + klobuchar.beta
    values = dict(zip(KLOBUCHAR_FIELDS, coefficients, strict=True))
    if utc is not None:
        values |= {
            "a0_s": utc.a0_s,
            "a1_sps": utc.a1_sps,
            "leap_s": utc.leap_s + BDT_MINUS_GPST_S,
            "leap_future_s": utc.leap_future_s + BDT_MINUS_GPST_S,
            "leap_week": (utc.leap_week - BDT_WEEK_OFFSET) % 256,
            "leap_day": utc.leap_day - 1,
        }
    return values


# --- the two formats -----------------------------------------------------------------------------

_D1: Final = _Kind("D1", 6.0, D1_PAGES, {(n, 0): 6.0 * (n - 1) for n in (1, 2, 3)}, (1, 0), (5, 10))
_D2: Final = _Kind(
    "D2",
    0.6,
    D2_PAGES,
    {(1, n): 3.0 * (n - 1) for n in (1, *range(3, 11))},
    (1, 2),
    (5, 102),
)


def encode_d1(
    start: GpsTime,
    ephemeris: Ephemeris,
    klobuchar: Klobuchar | None = None,
    utc: UtcParameters | None = None,
) -> Bits:
    """The 300 bits of the D1 subframe due at `start`, GPST by the satellite's clock.

    `start` lies a multiple of 6 s after the start of a BDT week. Almanac pages are filled with
    alternating ones and zeros; missing Klobuchar coefficients are zeros.
    """
    return _encode(_D1, start, ephemeris, klobuchar, utc)


def encode_d2(
    start: GpsTime,
    ephemeris: Ephemeris,
    klobuchar: Klobuchar | None = None,
    utc: UtcParameters | None = None,
) -> Bits:
    """The 300 bits of the D2 subframe due at `start`, a multiple of 0.6 s in BDT; as for D1."""
    return _encode(_D2, start, ephemeris, klobuchar, utc)


def _format(kind: _Kind) -> MessageFormat:
    return MessageFormat(
        name=kind.name,
        subframe_symbols=SUBFRAME_BITS,
        head_symbols=_HEAD_BITS,
        start=BeidouState,
        find_frames=partial(_find_frames, kind),
        collect=partial(_collect, kind),
    )


def sent_again(subframe: BeidouSubframe, start_tow_s: int) -> Bits:
    """The 300 bits of a subframe of D1 when it is sent at another time: only its second differs."""
    sow_s = int(start_tow_s + BDT_MINUS_GPST_S) % SECONDS_PER_WEEK
    behind = INFORMATION_BITS - HEADER_BITS
    head = subframe.information >> (behind + _SOW_BITS)
    return encode_words((head << _SOW_BITS | sow_s) << behind | subframe.payload)


D1: Final = replace(_format(_D1), again=sent_again, almanac_s=720)
"""The message of BeiDou MEO and IGSO satellites on B1I."""
D2: Final = _format(_D2)
"""The message of BeiDou GEO satellites on B1I."""
