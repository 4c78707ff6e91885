"""D1 and D2: error correction, round trips, frame search, and what u-blox receivers handed on."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_lnav import ublox_messages

from deepgnss.core.errors import NumericalError
from deepgnss.core.records import Ephemeris, Klobuchar, UtcParameters
from deepgnss.core.time import GpsTime
from deepgnss.io.rinex_nav import read_nav
from deepgnss.receiver import bch
from deepgnss.receiver.beidou_layout import D1_PAGES, D2_PAGES, FIELDS, INFORMATION_BITS
from deepgnss.receiver.beidou_nav import (
    D1,
    D2,
    PREAMBLE,
    decode_words,
    encode_d1,
    encode_d2,
    encode_words,
)
from deepgnss.receiver.messages import Bits, IonoUtc, MessageFormat

quiet = settings(deadline=None, derandomize=True, max_examples=40)

START = GpsTime(2290, 382_260.0 + 14.0)  # of a frame of D1, and of D2's page 1
KLOBUCHAR = Klobuchar(
    (12 * 2.0**-30, 2 * 2.0**-27, -(2.0**-24), -(2.0**-24)),
    (47 * 2.0**11, 4 * 2.0**14, -(2.0**16), -3 * 2.0**16),
)
UTC = UtcParameters(3 * 2.0**-30, -5 * 2.0**-50, GpsTime(2290, 14.0), 18, 19, 2301, 7)

_TIMES = ("toe_s", "toc_s")
_ELEMENTS = tuple(
    name for name in FIELDS if name in {f.name for f in fields(Ephemeris)} - {"toe", "toc"}
)


def ephemeris_of(raw: dict[str, int], satellite: str, toe: GpsTime) -> Ephemeris:
    """An ephemeris whose numbers are whole multiples of their last bits."""
    values: dict[str, Any] = {}
    for name in _ELEMENTS:
        bits, scale, signed = FIELDS[name]
        low = -(1 << (bits - 1)) if signed else 0
        values[name] = (low + raw[name] % (1 << bits)) * scale
    for name in ("iode", "iodc", "health"):
        values[name] = int(values[name])
    return Ephemeris(
        satellite=satellite, toe=toe, toc=toe, transmitted=toe, accuracy_m=2.0, **values
    )


def some_ephemeris(satellite: str = "C19", seed: int = 1) -> Ephemeris:
    random = np.random.default_rng(seed)
    raw = {name: int(random.integers(0, 2**32)) for name in _ELEMENTS}
    return ephemeris_of(raw, satellite, GpsTime(2290, 381_614.0))


def collected(message: MessageFormat, bits: Bits, satellite: str, near: GpsTime) -> list[Any]:
    """Everything new in a stream of symbols."""
    state, news = message.start(satellite), []
    for frame in message.find_frames(bits, 0):
        if frame.subframe is not None:
            state, new = message.collect(state, frame.subframe, near)
            news.extend(new)
    return news


def stream(message: MessageFormat, start: GpsTime, count: int, ephemeris: Ephemeris) -> Bits:
    encode, step_s = (encode_d1, 6.0) if message is D1 else (encode_d2, 0.6)
    return np.concatenate(
        [encode(start.plus(step_s * k), ephemeris, KLOBUCHAR, UTC) for k in range(count)]
    )


# --- error correction ----------------------------------------------------------------------------


def remainder(word: int) -> int:
    """Of division by X⁴ + X + 1, on paper."""
    for shift in range(10, -1, -1):
        if word >> (shift + 4) & 1:
            word ^= 0b10011 << shift
    return word


def bits_of(value: int, length: int) -> Bits:
    return np.array([value >> k & 1 for k in range(length - 1, -1, -1)], np.int8)


def test_every_code_word_is_divisible_by_the_generator() -> None:
    for value in range(2**11):
        code = bch.encode(bits_of(value, 11))
        word = int("".join(map(str, code)), 2)
        assert word >> 4 == value
        assert remainder(word) == 0


@quiet
@given(st.integers(0, 2**11 - 1))
def test_one_error_is_corrected_and_two_are_taken_for_another(value: int) -> None:
    code = bch.encode(bits_of(value, 11))
    for places in itertools.chain.from_iterable(
        itertools.combinations(range(15), n) for n in (0, 1, 2)
    ):
        wrong = code.copy()
        wrong[list(places)] ^= 1
        fixed, turned = bch.correct(wrong)
        assert turned == bool(places)
        assert remainder(int("".join(map(str, fixed)), 2)) == 0
        assert int((fixed != code).sum()) == (0 if len(places) < 2 else 3)


def test_first_fifteen_bits_stand_alone_and_the_rest_in_turns() -> None:
    """Of the interface document's figures: words 2–10 give the bits of two codes alternately."""
    information = int("10" * (INFORMATION_BITS // 2), 2) >> 3
    bits, plain = encode_words(information), bits_of(information, INFORMATION_BITS)
    np.testing.assert_array_equal(bits[:26], plain[:26])
    assert remainder(int("".join(map(str, bits[15:30])), 2)) == 0
    for word in range(1, 10):
        sent = bits[30 * word : 30 * word + 30]
        data = plain[26 + 22 * (word - 1) :][:22]
        for half in (0, 1):
            code = sent[half::2]
            np.testing.assert_array_equal(code[:11], data[11 * half : 11 * half + 11])
            assert remainder(int("".join(map(str, code)), 2)) == 0
    assert decode_words(bits) == (information, 0)


@quiet
@given(st.integers(0, 2**INFORMATION_BITS - 1), st.sets(st.integers(0, 18), max_size=19))
def test_an_error_in_each_code_word_is_corrected(information: int, codes: set[int]) -> None:
    bits = encode_words(information)
    for code in codes:
        # Of code 0 the bits are 15–29, of the others every second one of a word.
        bits[20 if code == 0 else 30 * ((code + 1) // 2) + 6 + (code - 1) % 2] ^= 1
    assert decode_words(bits) == (information, len(codes))


# --- layout --------------------------------------------------------------------------------------

# Where fields start in the interface document's count of 300 bits (figures 5-6 to 5-12 and 5-19).
_STARTS_D1 = {
    (1, 0): {"health": 43, "iodc": 44, "ura_index": 49, "week": 61, "toc_s": 74}
    | {"group_delay_s": 99, "alpha0": 127, "beta3": 199, "af2_sps2": 215, "af0_s": 226}
    | {"af1_sps": 258, "iode": 288},
    (2, 0): {"delta_n_radps": 43, "cuc_rad": 67, "m0_rad": 93, "eccentricity": 133}
    | {"cus_rad": 181, "crc_m": 199, "crs_m": 225, "sqrt_a_rm": 251, "toe_s": 291},
    (3, 0): {"toe_s": 43, "i0_rad": 66, "cic_rad": 106, "omega_dot_radps": 132, "cis_rad": 164}
    | {"idot_radps": 190, "omega0_rad": 212, "omega_rad": 252},
    (5, 10): {"leap_s": 51, "leap_week": 75, "a0_s": 91, "a1_sps": 131, "leap_day": 163},
}
_STARTS_D2 = {
    (1, 1): {"d2_page": 43, "health": 47, "toc_s": 78, "group_delay2_s": 121},
    (1, 2): {"alpha0": 47, "alpha3": 79, "beta3": 127},
    (1, 3): {"af0_s": 101, "af1_sps": 133},
    (1, 4): {"af1_sps": 47, "af2_sps2": 73, "iode": 92, "delta_n_radps": 97, "cuc_rad": 121},
    (1, 5): {"cuc_rad": 47, "m0_rad": 51, "cus_rad": 99, "eccentricity": 125},
    (1, 6): {"eccentricity": 47, "sqrt_a_rm": 77, "cic_rad": 125},
    (1, 7): {"cic_rad": 47, "cis_rad": 63, "toe_s": 81, "i0_rad": 106},
    (1, 8): {"i0_rad": 47, "crc_m": 66, "crs_m": 92, "omega_dot_radps": 110},
    (1, 9): {"omega_dot_radps": 47, "omega0_rad": 52, "omega_rad": 100},
    (1, 10): {"omega_rad": 47, "idot_radps": 52},
}


@pytest.mark.parametrize(("pages", "starts"), [(D1_PAGES, _STARTS_D1), (D2_PAGES, _STARTS_D2)])
def test_fields_lie_where_the_document_has_them(pages: Any, starts: Any) -> None:
    for page, wanted in starts.items():
        at, found = 38, {}
        for name, length in pages[page]:
            word, bit = (0, at) if at < 26 else (1 + (at - 26) // 22, (at - 26) % 22)
            found[name] = 30 * word + bit + 1
            at += length
        assert {name: found[name] for name in wanted} == wanted, page
    for name in set(FIELDS) - {"page", "d2_page"}:
        total = sum(n for layout in pages.values() for field, n in layout if field == name)
        assert total == FIELDS[name].bits, name


# --- round trips ---------------------------------------------------------------------------------

raw_fields = st.fixed_dictionaries({name: st.integers(0, 2**32 - 1) for name in _ELEMENTS})


@quiet
@given(raw_fields, st.integers(0, 20_159), st.sampled_from([D1, D2]))
def test_ephemeris_round_trip(raw: dict[str, int], frame: int, message: MessageFormat) -> None:
    """Also across the end of the week, of BDT or of GPST."""
    start = GpsTime(2290, 30.0 * frame).plus(14.0)
    toe = GpsTime(2290, 3600.0 * round(frame / 120)).plus(14.0)
    satellite = "C19" if message is D1 else "C03"
    ephemeris = replace(ephemeris_of(raw, satellite, toe), transmitted=start)
    bits = stream(message, start, 5 if message is D1 else 50, ephemeris)
    (got,) = (new for new in collected(message, bits, satellite, start) if type(new) is Ephemeris)
    assert got == ephemeris


@pytest.mark.parametrize(("message", "count"), [(D1, 5 * 24), (D2, 5 * 120)])
def test_ionosphere_and_utc_come_once(message: MessageFormat, count: int) -> None:
    bits = stream(message, START, count, some_ephemeris())
    news = [item for item in collected(message, bits, "C03", START) if isinstance(item, IonoUtc)]
    assert news == [IonoUtc(KLOBUCHAR, None, "C"), IonoUtc(None, UTC, "C")]


def test_a_value_that_needs_more_bits_is_refused() -> None:
    with pytest.raises(NumericalError, match="cuc_rad"):
        encode_d1(START.plus(6.0), replace(some_ephemeris(), cuc_rad=1.0))


def test_sets_never_mix() -> None:
    """A set changes on the hour: subframe 1 of the old with 2 and 3 of the new is none."""
    old, new = some_ephemeris(seed=1), some_ephemeris(seed=2)
    last = GpsTime(2290, 107 * 3600.0 - 30.0 + 14.0)
    first, second = stream(D1, last, 5, old), stream(D1, last.plus(30.0), 5, new)
    spoilt = first.copy()
    spoilt[330:900:7] ^= 1
    bits = np.concatenate([spoilt, second[300:]])  # subframe 1 of the new set is not there
    assert not [n for n in collected(D1, bits, "C19", START) if isinstance(n, Ephemeris)]
    bits = np.concatenate([spoilt, second])
    (got,) = (n for n in collected(D1, bits, "C19", START) if isinstance(n, Ephemeris))
    assert got.m0_rad == new.m0_rad


def test_neighbouring_frames_of_an_hour_complete_each_other() -> None:
    """A receiver switched on in mid-frame has an ephemeris half a minute later."""
    one = some_ephemeris()
    bits = np.concatenate([stream(D1, START.plus(30.0 * k), 5, one) for k in range(2)])
    late = bits[300 : 1500 + 300]  # subframes 2 to 5, and 1 of the next frame
    (got,) = (n for n in collected(D1, late, "C19", START) if isinstance(n, Ephemeris))
    assert replace(got, transmitted=one.transmitted) == one


def test_a_corrected_subframe_counts_once_it_has_come_twice_alike() -> None:
    one = some_ephemeris()
    frames = [stream(D1, START.plus(30.0 * k), 5, one) for k in range(3)]
    for frame in frames:
        frame[300 + 77] ^= 1  # the same bit of subframe 2: as a fault would be, not noise
    assert not [n for n in collected(D1, frames[0], "C19", START) if isinstance(n, Ephemeris)]
    news = collected(D1, np.concatenate(frames), "C19", START)
    (got,) = (n for n in news if isinstance(n, Ephemeris))
    assert got.cuc_rad == one.cuc_rad
    assert got.transmitted == START.plus(30.0)


# --- frame search --------------------------------------------------------------------------------


@pytest.mark.parametrize("polarity", [0, 1])
@pytest.mark.parametrize(("message", "step_s"), [(D1, 6.0), (D2, 0.6)])
def test_frames_are_found_in_both_polarities(
    message: MessageFormat, step_s: float, polarity: int
) -> None:
    noise = np.random.default_rng(3).integers(0, 2, 137).astype(np.int8)
    bits = np.concatenate([noise, stream(message, START, 12, some_ephemeris())]) ^ polarity
    frames = [f for f in message.find_frames(bits, 0) if f.confirmed]
    assert [f.first for f in frames] == [137 + 300 * k for k in range(12)]
    assert {f.polarity for f in frames} == {polarity}
    assert [f.subframe_id for f in frames] == [k % 5 + 1 for k in range(12)]
    starts = [f.start_tow_s for f in frames]
    assert starts == pytest.approx([START.tow_s + step_s * k for k in range(12)], abs=1e-9)


@pytest.mark.parametrize("message", [D1, D2])
def test_a_head_is_told_at_once_and_confirmed_by_the_next(message: MessageFormat) -> None:
    bits = stream(message, START, 3, some_ephemeris())
    (head,) = message.find_frames(bits[:60], 0)
    assert (head.first, head.confirmed, head.subframe) == (0, False, None)
    assert head.start_tow_s == START.tow_s
    bits[60:300:7] ^= 1  # too much to correct
    first, second = message.find_frames(bits[:650], 0)[:2]
    assert (first.first, first.confirmed, first.subframe) == (0, True, None)
    assert second.first == 300
    elsewhere = np.concatenate([bits[:300], bits[600:900]])
    assert all(f.first != 0 for f in message.find_frames(elsewhere, 0))


def test_noise_holds_no_confirmed_frame() -> None:
    bits = np.random.default_rng(5).integers(0, 2, 200_000).astype(np.int8)
    assert not [f for f in D1.find_frames(bits, 0) if f.confirmed]
    heads = D1.find_frames(bits, 0)
    assert len(heads) <= 2  # 2/2048 · 2⁻¹² · 5/8 · 0.58 a place


# --- what receivers in Oxford decoded ------------------------------------------------------------


def ublox_subframes(path: Path) -> Iterator[tuple[str, int, Bits]]:
    """D1 subframes as 300 transmitted bits: satellite, u-blox's signal number (0 B1I, 2 B2I), bits.

    The receiver hands on words put in order again: 22 bits of information, then both parities.
    """
    for kind, payload in ublox_messages(path.read_bytes()):
        if kind == 0x0213 and payload[0] == 3:
            words = struct.unpack_from("<10I", payload, 8)
            out = [bits_of(words[0], 30)]
            for word in words[1:]:
                plain = bits_of(word, 30)
                sent = np.empty(30, np.int8)
                sent[0::2] = np.concatenate([plain[:11], plain[22:26]])
                sent[1::2] = np.concatenate([plain[11:22], plain[26:]])
                out.append(sent)
            yield f"C{payload[1]:02d}", payload[2], np.concatenate(out)


def test_real_subframes_are_all_decoded(shared_data: Path) -> None:
    """All but one of 714, which the receiver made up in fading: no week has second 916 611.

    (It hands on corrected words, so that their parities hold whatever was received.)
    """
    refused = []
    for name, count in (("snapper-ubx/COM6_211122_123733", 670), ("ubx-misc/nhm", 44)):
        received = list(ublox_subframes(shared_data / f"real/gnss/{name}.ubx"))
        assert len(received) == count
        for satellite, _, bits in received:
            frames = D1.find_frames(bits, 0)
            turned = D1.find_frames(bits ^ 1, 0)
            assert [f.subframe for f in turned] == [f.subframe for f in frames]
            if frames:
                (frame,) = frames
                assert frame.first == 0
                assert frame.subframe.corrected == 0
                count_30s = (frame.start_tow_s - 14.0) // 6
                assert frame.subframe_id == count_30s % 5 + 1
            else:
                information, corrected = decode_words(bits)
                second = information >> INFORMATION_BITS - 38 & 0xFFFFF
                refused.append((satellite, corrected, second))
    assert refused == [("C34", 0, 916_611)]


def test_real_subframes_give_the_ephemerides_others_decoded(shared_data: Path) -> None:
    """And encoding those gives the subframes again, bit for bit."""
    folder = shared_data / "real/gnss/snapper-ubx"
    states: dict[str, Any] = {}
    got: dict[str, Ephemeris] = {}
    ionosphere: dict[str, Klobuchar] = {}
    sent: dict[str, dict[tuple[float, int], Bits]] = {}
    for satellite, signal, bits in ublox_subframes(folder / "COM6_211122_123733.ubx"):
        if signal != 0:
            continue
        frames = D1.find_frames(bits, 0)
        if not frames:
            continue
        (frame,) = frames
        sent.setdefault(satellite, {})[frame.start_tow_s, frame.subframe_id] = bits
        state = states.get(satellite, D1.start(satellite))
        states[satellite], news = D1.collect(state, frame.subframe, None)
        for new in news:
            if isinstance(new, Ephemeris):
                got[satellite] = new
            elif new.klobuchar is not None:
                ionosphere[satellite] = new.klobuchar
    reference = {
        name: sets
        for name, sets in read_nav(folder / "w00_f9p.nav").ephemerides.items()
        if name[0] == "C"
    }
    assert got.keys() == reference.keys()
    assert len(got) == 8
    for name, (wanted,) in reference.items():
        for field in fields(Ephemeris):
            value, printed = getattr(got[name], field.name), getattr(wanted, field.name)
            if field.name == "transmitted":
                assert abs(printed.since(value)) <= 360.0
            elif field.name == "iode":  # theirs is none of the message's
                assert printed == (wanted.toe.tow_s - 14.0) // 720 % 240
            elif isinstance(value, float):
                assert value == pytest.approx(printed, rel=1e-11, abs=1e-30), (name, field.name)
            else:
                assert value == printed, (name, field.name)
    compared = 0
    for satellite, subframes in sent.items():
        for (tow_s, number), bits in subframes.items():
            if number <= 3 and satellite in got:
                start = GpsTime(got[satellite].transmitted.week, tow_s)
                again = encode_d1(start, got[satellite], ionosphere.get(satellite))
                np.testing.assert_array_equal(again, bits)
                compared += 1
    assert compared > 200


def test_preamble() -> None:
    assert "".join(map(str, PREAMBLE)) == "11100010010"
