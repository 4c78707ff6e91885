"""GPS LNAV: words, parity, subframes to ephemerides and back (IS-GPS-200 20.3).

One table of fields (`PAGES`) serves encoder and decoder. Bits are 0/1, first bit first; word and
bit numbers count from 1 as in the interface specification.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.constants import GPS_PI, SECONDS_PER_WEEK
from deepgnss.core.errors import NumericalError
from deepgnss.core.records import Ephemeris, Klobuchar, UtcParameters
from deepgnss.core.time import GpsTime, resolve_week
from deepgnss.receiver.messages import Bits, MessageFormat, News, nearest
from deepgnss.receiver.messages import Frame as Frame
from deepgnss.receiver.messages import IonoUtc as IonoUtc

WORD_BITS: Final = 30
SUBFRAME_BITS: Final = 300
SUBFRAME_S: Final = 6
PREAMBLE: Final = np.array([1, 0, 0, 0, 1, 0, 1, 1], dtype=np.int8)
IONO_UTC_PAGE: Final = 18  # of subframe 4, SV ID 56
_IONO_UTC_SV_ID: Final = 56
_TOW_COUNTS: Final = SECONDS_PER_WEEK // SUBFRAME_S

# --- fields --------------------------------------------------------------------------------------


class Field(NamedTuple):
    """One number of a subframe: where its bits lie, and what they count."""

    name: str
    pieces: tuple[tuple[int, int, int], ...]  # (word, first bit, length), most significant first
    scale: float = 1.0
    signed: bool = False

    @property
    def length(self) -> int:
        """Number of bits of all pieces together."""
        return sum(length for _, _, length in self.pieces)


def _split(name: str, word: int, scale: float, signed: bool = True) -> Field:
    """A 32-bit number: bits 17–24 of one word, all 24 of the next."""
    return Field(name, ((word, 17, 8), (word + 1, 1, 24)), scale, signed)


PAGES: Final[Mapping[int, tuple[Field, ...]]] = {
    1: (  # IS-GPS-200 table 20-I
        Field("week", ((3, 1, 10),)),
        Field("l2_code", ((3, 11, 2),)),
        Field("ura_index", ((3, 13, 4),)),
        Field("health", ((3, 17, 6),)),
        Field("iodc", ((3, 23, 2), (8, 1, 8))),
        Field("group_delay_s", ((7, 17, 8),), 2.0**-31, True),
        Field("toc_s", ((8, 9, 16),), 2.0**4),
        Field("af2_sps2", ((9, 1, 8),), 2.0**-55, True),
        Field("af1_sps", ((9, 9, 16),), 2.0**-43, True),
        Field("af0_s", ((10, 1, 22),), 2.0**-31, True),
    ),
    2: (  # table 20-III
        Field("iode", ((3, 1, 8),)),
        Field("crs_m", ((3, 9, 16),), 2.0**-5, True),
        Field("delta_n_radps", ((4, 1, 16),), 2.0**-43 * GPS_PI, True),
        _split("m0_rad", 4, 2.0**-31 * GPS_PI),
        Field("cuc_rad", ((6, 1, 16),), 2.0**-29, True),
        _split("eccentricity", 6, 2.0**-33, signed=False),
        Field("cus_rad", ((8, 1, 16),), 2.0**-29, True),
        _split("sqrt_a_rm", 8, 2.0**-19, signed=False),
        Field("toe_s", ((10, 1, 16),), 2.0**4),
        Field("fit_flag", ((10, 17, 1),)),
    ),
    3: (
        Field("cic_rad", ((3, 1, 16),), 2.0**-29, True),
        _split("omega0_rad", 3, 2.0**-31 * GPS_PI),
        Field("cis_rad", ((5, 1, 16),), 2.0**-29, True),
        _split("i0_rad", 5, 2.0**-31 * GPS_PI),
        Field("crc_m", ((7, 1, 16),), 2.0**-5, True),
        _split("omega_rad", 7, 2.0**-31 * GPS_PI),
        Field("omega_dot_radps", ((9, 1, 24),), 2.0**-43 * GPS_PI, True),
        Field("iode", ((10, 1, 8),)),
        Field("idot_radps", ((10, 9, 14),), 2.0**-43 * GPS_PI, True),
    ),
    IONO_UTC_PAGE: (  # tables 20-IX, 20-X
        Field("data_id", ((3, 1, 2),)),
        Field("sv_id", ((3, 3, 6),)),
        Field("alpha0", ((3, 9, 8),), 2.0**-30, True),
        Field("alpha1", ((3, 17, 8),), 2.0**-27, True),
        Field("alpha2", ((4, 1, 8),), 2.0**-24, True),
        Field("alpha3", ((4, 9, 8),), 2.0**-24, True),
        Field("beta0", ((4, 17, 8),), 2.0**11, True),
        Field("beta1", ((5, 1, 8),), 2.0**14, True),
        Field("beta2", ((5, 9, 8),), 2.0**16, True),
        Field("beta3", ((5, 17, 8),), 2.0**16, True),
        Field("a1_sps", ((6, 1, 24),), 2.0**-50, True),
        Field("a0_s", ((7, 1, 24), (8, 1, 8)), 2.0**-30, True),
        Field("tot_s", ((8, 9, 8),), 2.0**12),
        Field("week_tot", ((8, 17, 8),)),
        Field("leap_s", ((9, 1, 8),), 1.0, True),
        Field("leap_week", ((9, 9, 8),)),
        Field("leap_day", ((9, 17, 8),)),
        Field("leap_future_s", ((10, 1, 8),), 1.0, True),
    ),
}

# URA in metres by index (20.3.3.3.1.3); index 15 means "no prediction".
URA_M: Final = (2.0, 2.8, 4.0, 5.7, 8.0, 11.3, 16.0) + tuple(2.0 ** (n - 2) for n in range(7, 16))

# Fit interval in hours by IODC when the fit flag is set (table 20-XII); 6 h for all others.
_FIT_HOURS: Final = (
    (range(240, 248), 8.0),
    (range(248, 256), 14.0),
    (range(496, 497), 14.0),
    (range(497, 504), 26.0),
    (range(504, 511), 50.0),
    (range(511, 512), 74.0),
    (range(752, 757), 74.0),
    (range(757, 764), 98.0),
    (range(764, 768), 122.0),
    (range(1008, 1011), 122.0),
    (range(1011, 1021), 146.0),
)

_EPHEMERIS_FIELDS: Final = frozenset(f.name for f in fields(Ephemeris))


def _unpack(page: int, words: Sequence[int]) -> dict[str, float]:
    """Values of all fields of a page from its ten 24-bit data words."""
    values = {}
    for field in PAGES[page]:
        raw = 0
        for word, first, length in field.pieces:
            raw = raw << length | (words[word - 1] >> (25 - first - length)) & ((1 << length) - 1)
        if field.signed and raw >> (field.length - 1):
            raw -= 1 << field.length
        values[field.name] = raw * field.scale
    return values


def _pack(page: int, values: Mapping[str, float]) -> list[int]:
    """Ten 24-bit data words holding the fields of a page (words 1 and 2 empty)."""
    words = [0] * 10
    for field in PAGES[page]:
        raw = round(values[field.name] / field.scale)
        low = -(1 << (field.length - 1)) if field.signed else 0
        if not low <= raw < low + (1 << field.length):
            raise NumericalError(
                f"LNAV page {page}, {field.name}: {values[field.name]} needs more than "
                f"{field.length} bits of {field.scale:g}"
            )
        for word, first, length in reversed(field.pieces):
            words[word - 1] |= (raw & ((1 << length) - 1)) << (25 - first - length)
            raw >>= length
    return words


# --- words ---------------------------------------------------------------------------------------


def _parity_rows() -> tuple[Bits, Bits]:
    """Parity matrix over d1…d24, shape (6, 24), and over D29*, D30*, shape (6, 2)."""
    rows = (  # table 20-XIV: D29* or D30*, then the data bits
        (29, (1, 2, 3, 5, 6, 10, 11, 12, 13, 14, 17, 18, 20, 23)),
        (30, (2, 3, 4, 6, 7, 11, 12, 13, 14, 15, 18, 19, 21, 24)),
        (29, (1, 3, 4, 5, 7, 8, 12, 13, 14, 15, 16, 19, 20, 22)),
        (30, (2, 4, 5, 6, 8, 9, 13, 14, 15, 16, 17, 20, 21, 23)),
        (30, (1, 3, 5, 6, 7, 9, 10, 14, 15, 16, 17, 18, 21, 22, 24)),
        (29, (3, 5, 6, 8, 9, 10, 11, 13, 15, 19, 22, 23, 24)),
    )
    data, before = np.zeros((6, 24), np.int8), np.zeros((6, 2), np.int8)
    for row, (star, bits) in enumerate(rows):
        data[row, np.array(bits) - 1] = 1
        before[row, star - 29] = 1
    return data, before


_PARITY_DATA, _PARITY_BEFORE = _parity_rows()


def parity(data: Bits, before: Bits) -> Bits:
    """Six parity bits D25…D30 of source data bits (IS-GPS-200 table 20-XIV).

    Parameters: data, shape (…, 24); before, D29* and D30* of the word before, shape (…, 2).
    """
    return (data @ _PARITY_DATA.T + before @ _PARITY_BEFORE.T) & 1


def check_words(bits: Bits, before: Sequence[int]) -> tuple[Bits, NDArray[np.bool_]]:
    """Source data bits of consecutive words and whether their parity holds.

    Parameters: bits as received, shape (30·n,), of either polarity; before, the two bits ahead of
    them (of the same polarity). Returns data bits (n, 24), upright, and parity verdicts (n,).
    """
    words = bits.reshape(-1, WORD_BITS)
    stars = np.vstack([np.array(before, np.int8), words[:-1, 28:]])
    data = words[:, :24] ^ stars[:, 1:]
    return data, (parity(data, stars) == words[:, 24:]).all(axis=1)


def encode_words(words: Sequence[int]) -> Bits:
    """Transmitted bits, shape (30·n,), of up to ten data words from a subframe's start on.

    Words 2 and 10 end in D29 = D30 = 0.

    Bits 23 and 24 of those two words are free for that purpose (20.3.3.1, 20.3.3.2).
    """
    before = np.zeros(2, np.int8)
    out = []
    for number, word in enumerate(words, start=1):
        data = np.array([word >> shift & 1 for shift in range(23, -1, -1)], np.int8)
        if number in (2, 10):
            data[22:] = 0
            d29, d30 = parity(data, before)[4:]
            data[22:] = d29 ^ d30, d29  # d24 enters D29 and D30, d23 D30 alone
        check = parity(data, before)
        out += [data ^ before[1], check]
        before = check[4:]
    return np.concatenate(out)


def _integers(data: Bits) -> tuple[int, ...]:
    return tuple(int(word) for word in data.astype(np.int64) @ (1 << np.arange(23, -1, -1)))


# --- subframes -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Subframe:
    """A subframe whose ten parities held."""

    start_tow_s: int  # satellite time at which its first bit left
    subframe_id: int
    alert: bool  # user range accuracy may be worse than stated
    anti_spoof: bool
    words: tuple[int, ...]  # ten data words of 24 bits, upright


def _handover(word: int) -> tuple[int, int] | None:
    """Start time and number of a subframe from its HOW, None where neither can be (20.3.3.2)."""
    count, subframe_id = word >> 7, word >> 2 & 7
    if count >= _TOW_COUNTS or not 1 <= subframe_id <= 5:
        return None
    return (count - 1) % _TOW_COUNTS * SUBFRAME_S, subframe_id


def decode_subframe(bits: Bits, before: Sequence[int] = (0, 0)) -> Subframe | None:
    """A subframe from its 300 bits, None if a parity fails or HOW or preamble make no sense.

    Parameters: bits as received, shape (300,), of either polarity; before, the two bits ahead
    (of the same polarity; upright ones are always 0, 0).
    """
    data, ok = check_words(bits, before)
    if not ok.all() or not np.array_equal(data[0, :8], PREAMBLE):
        return None
    words = _integers(data)
    handover = _handover(words[1])
    if handover is None:
        return None
    return Subframe(*handover, bool(words[1] >> 6 & 1), bool(words[1] >> 5 & 1), words)


def find_frames(bits: Bits, first: int = 0) -> list[Frame]:
    """All places from index `first` on where a subframe starts (20.3.3.1, 20.3.3.2).

    Needed: the preamble in either polarity, the parities of telemetry and hand-over word, D29 and
    D30 of the latter zero, a possible time and number. If 60 bits of the next subframe are there
    too, they must read as its successor, unless all ten parities of this one hold.

    Parameters: bits, 0/1, shape (n,). Returns frames in the order of the stream.
    """
    if bits.size - first < 2 * WORD_BITS:
        return []
    windows = np.lib.stride_tricks.sliding_window_view(bits[first : bits.size - 52], 8)
    hits = (windows == PREAMBLE).sum(axis=1)
    frames = []
    for index in np.flatnonzero(hits % 8 == 0) + first:
        frame = _frame_at(bits, int(index))
        if frame is not None:
            frames.append(frame)
    return frames


def _frame_at(bits: Bits, first: int) -> Frame | None:
    head = _head_at(bits, first)
    if head is None:
        return None
    polarity, start_tow_s, subframe_id = head
    subframe = None
    if bits.size >= first + SUBFRAME_BITS:
        subframe = decode_subframe(bits[first : first + SUBFRAME_BITS], (polarity, polarity))
    follows = False
    if bits.size >= first + SUBFRAME_BITS + 2 * WORD_BITS:
        after = _head_at(bits, first + SUBFRAME_BITS)
        successor = ((start_tow_s + SUBFRAME_S) % SECONDS_PER_WEEK, subframe_id % 5 + 1)
        follows = after is not None and after[1:] == successor
        if not follows and subframe is None:
            return None
    return Frame(
        first, polarity, start_tow_s, subframe_id, follows or subframe is not None, subframe
    )


def _head_at(bits: Bits, first: int) -> tuple[int, int, int] | None:
    """Polarity, start time and number from telemetry and hand-over word, or None."""
    head = bits[first : first + 2 * WORD_BITS]
    polarity = int(head[0] ^ 1)  # the preamble starts with 1, and D30* before it is 0
    data, ok = check_words(head, (polarity, polarity))
    if not ok.all() or (head[58:] != polarity).any() or (data[0, :8] != PREAMBLE).any():
        return None
    handover = _handover(_integers(data)[1])
    return None if handover is None else (polarity, *handover)


# --- from subframes to records -------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class LnavState:
    """What was gathered from one satellite: the latest of each page, and what they gave."""

    satellite: str
    pages: Mapping[int, Subframe]
    ephemeris: Ephemeris | None = None


def start(satellite: str) -> LnavState:
    """State before the first subframe."""
    return LnavState(satellite, {})


def collect(
    state: LnavState, subframe: Subframe, near: GpsTime | None = None
) -> tuple[LnavState, tuple[News, ...]]:
    """Take in a subframe; hand out what it completes, if that is new.

    Subframes 1–3 give an ephemeris when the issues agree (IODE of 2 and 3, low byte of IODC,
    20.3.4.4) and all three left within two hours: sets of different issue never mix.

    Parameters: near, a rough date for the week rollover (default: 2019–2038).
    """
    page = _page(subframe)
    if page is None:
        return state, ()
    state = replace(state, pages={**state.pages, page: subframe})
    if page == IONO_UTC_PAGE:
        known = state.ephemeris.transmitted if state.ephemeris else near
        return state, (_iono_utc(subframe, known),)
    ephemeris = _ephemeris(state, near)
    previous = state.ephemeris
    if ephemeris is None or (
        previous is not None and ephemeris == replace(previous, transmitted=ephemeris.transmitted)
    ):
        return state, ()
    return replace(state, ephemeris=ephemeris), (ephemeris,)


def _page(subframe: Subframe) -> int | None:
    """Key of PAGES the subframe belongs to, None for almanacs and the like."""
    if subframe.subframe_id <= 3:
        return subframe.subframe_id
    sv_id = subframe.words[2] >> 16 & 63
    return IONO_UTC_PAGE if subframe.subframe_id == 4 and sv_id == _IONO_UTC_SV_ID else None


def _ephemeris(state: LnavState, near: GpsTime | None) -> Ephemeris | None:
    if not {1, 2, 3} <= state.pages.keys():
        return None
    parts = [state.pages[page] for page in (1, 2, 3)]
    starts = [part.start_tow_s for part in parts]
    spread_s = max((a - b) % SECONDS_PER_WEEK for a in starts for b in starts)
    one, two, three = (_unpack(page, part.words) for page, part in enumerate(parts, start=1))
    issues = {two["iode"], three["iode"], float(int(one["iodc"]) & 255)}
    if len(issues) > 1 or min(spread_s, SECONDS_PER_WEEK - spread_s) > 7200:
        return None
    values = one | two | three
    transmitted = GpsTime(resolve_week(int(one["week"]), near), float(starts[0]))
    named = {name: value for name, value in values.items() if name in _EPHEMERIS_FIELDS}
    integers = {name: int(values[name]) for name in ("iode", "iodc", "health")}
    return Ephemeris(
        satellite=state.satellite,
        transmitted=transmitted,
        toe=nearest(values["toe_s"], transmitted),
        toc=nearest(values["toc_s"], transmitted),
        accuracy_m=URA_M[int(values["ura_index"])],
        fit_hours=_fit_hours(bool(values["fit_flag"]), integers["iodc"]),
        **(named | integers),  # type: ignore[arg-type]  # the table names the rest
    )


def _iono_utc(subframe: Subframe, near: GpsTime | None) -> IonoUtc:
    values = _unpack(IONO_UTC_PAGE, subframe.words)
    a0, a1, a2, a3 = (values[f"alpha{n}"] for n in range(4))
    b0, b1, b2, b3 = (values[f"beta{n}"] for n in range(4))
    now = resolve_week(0, None) if near is None else near.week
    return IonoUtc(
        Klobuchar((a0, a1, a2, a3), (b0, b1, b2, b3)),
        UtcParameters(
            a0_s=values["a0_s"],
            a1_sps=values["a1_sps"],
            reference=GpsTime(_full_week(int(values["week_tot"]), now), values["tot_s"]),
            leap_s=int(values["leap_s"]),
            leap_future_s=int(values["leap_future_s"]),
            leap_week=_full_week(int(values["leap_week"]), now),
            leap_day=int(values["leap_day"]),
        ),
    )


def _full_week(week_mod_256: int, near_week: int) -> int:
    return near_week + (week_mod_256 - near_week + 128) % 256 - 128


def _fit_hours(flag: bool, iodc: int) -> float:
    if not flag:
        return 4.0
    return next((hours for issues, hours in _FIT_HOURS if iodc in issues), 6.0)


# --- from records to subframes -------------------------------------------------------------------


def encode_subframe(
    start: GpsTime,
    subframe_id: int,
    ephemeris: Ephemeris,
    iono_utc: IonoUtc | None = None,
    page: int | None = None,
    telemetry: int = 0,
) -> Bits:
    """The 300 transmitted bits of a subframe, upright; consecutive ones chain (D29* = D30* = 0).

    Parameters
    ----------
    start: satellite time at which the first bit leaves, a multiple of 6 s.
    subframe_id: 1–5. Subframe 4 carries `iono_utc` on page 18 and, like subframe 5, the dummy SV
        elsewhere (alternating ones and zeros, 20.3.3.5.1.1).
    page: 1–25 of subframes 4 and 5; by default the one due at `start`.
    telemetry: the 16 bits behind the preamble, message, integrity flag and a reserved one.
    """
    if page is None:
        page = int(start.tow_s) // 30 % 25 + 1
    if subframe_id <= 3:
        words = _pack(subframe_id, _values(ephemeris, start))
    elif (
        (subframe_id, page) == (4, IONO_UTC_PAGE)
        and iono_utc is not None
        and iono_utc.klobuchar is not None
        and iono_utc.utc is not None
    ):
        words = _pack(IONO_UTC_PAGE, _iono_utc_values(iono_utc.klobuchar, iono_utc.utc))
    else:
        words = [0, 0, 0x40AAAA] + [0xAAAAAA] * 7
    count = (int(start.tow_s) // SUBFRAME_S + 1) % _TOW_COUNTS
    words[0] = 0x8B << 16 | telemetry
    words[1] = count << 7 | subframe_id << 2
    return encode_words(words)


def _values(ephemeris: Ephemeris, start: GpsTime) -> dict[str, float]:
    named = {name: getattr(ephemeris, name) for name in _EPHEMERIS_FIELDS}
    return named | {
        "week": start.week % 1024,
        "l2_code": 1,
        "ura_index": next(n for n, m in enumerate(URA_M) if m >= min(ephemeris.accuracy_m, 8192)),
        "toc_s": ephemeris.toc.tow_s,
        "toe_s": ephemeris.toe.tow_s,
        "fit_flag": ephemeris.fit_hours > 4.0,
    }


def _iono_utc_values(klobuchar: Klobuchar, utc: UtcParameters) -> dict[str, float]:
    return {
        "data_id": 1,
        "sv_id": _IONO_UTC_SV_ID,
        **{f"alpha{n}": value for n, value in enumerate(klobuchar.alpha)},
        **{f"beta{n}": value for n, value in enumerate(klobuchar.beta)},
        "a0_s": utc.a0_s,
        "a1_sps": utc.a1_sps,
        "tot_s": utc.reference.tow_s,
        "week_tot": utc.reference.week % 256,
        "leap_s": utc.leap_s,
        "leap_week": utc.leap_week % 256,
        "leap_day": utc.leap_day,
        "leap_future_s": utc.leap_future_s,
    }


def sent_again(subframe: Subframe, start_tow_s: int) -> Bits:
    """The 300 bits of a subframe when it is sent at another time: only its count differs."""
    words = list(subframe.words)
    count = (start_tow_s // SUBFRAME_S + 1) % _TOW_COUNTS
    words[1] = words[1] & ((1 << 7) - 1) | count << 7
    return encode_words(words)


LNAV: Final = MessageFormat(
    name="LNAV",
    subframe_symbols=SUBFRAME_BITS,
    head_symbols=2 * WORD_BITS,
    start=start,
    find_frames=find_frames,
    collect=collect,
    again=sent_again,
)
"""The message of GPS L1 C/A."""
