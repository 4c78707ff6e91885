"""What the pages of BeiDou's D1 and D2 hold, as tables that serve encoder and decoder.

A subframe carries 224 bits of information. Read without parity and interleaving they are dense: a
field that the interface document splits over words is one piece here, and a page is just the list
of its fields. Fields split over pages name their pieces in both (BDS-SIS-ICD B1I 5.2.3, 5.3.2).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from deepgnss.core.constants import GPS_PI
from deepgnss.core.errors import NumericalError

INFORMATION_BITS: Final = 26 + 9 * 22
"""Of a subframe: 26 in the first word, 22 in each of the others."""
HEADER_BITS: Final = 11 + 4 + 3 + 20
"""Of them: preamble, reserved, number of the subframe, second of week."""


class Field(NamedTuple):
    """How a number is written: bits, unit of the last one, two's complement or not."""

    bits: int
    scale: float = 1.0
    signed: bool = False


FIELDS: Final[Mapping[str, Field]] = {
    "page": Field(7),
    "d2_page": Field(4),
    "health": Field(1),
    "iodc": Field(5),  # AODC
    "ura_index": Field(4),
    "week": Field(13),
    "toc_s": Field(17, 2.0**3),
    "group_delay_s": Field(10, 1e-10, True),  # TGD1
    "group_delay2_s": Field(10, 1e-10, True),
    "alpha0": Field(8, 2.0**-30, True),
    "alpha1": Field(8, 2.0**-27, True),
    "alpha2": Field(8, 2.0**-24, True),
    "alpha3": Field(8, 2.0**-24, True),
    "beta0": Field(8, 2.0**11, True),
    "beta1": Field(8, 2.0**14, True),
    "beta2": Field(8, 2.0**16, True),
    "beta3": Field(8, 2.0**16, True),
    "af2_sps2": Field(11, 2.0**-66, True),
    "af0_s": Field(24, 2.0**-33, True),
    "af1_sps": Field(22, 2.0**-50, True),
    "iode": Field(5),  # AODE
    "delta_n_radps": Field(16, 2.0**-43 * GPS_PI, True),
    "cuc_rad": Field(18, 2.0**-31, True),
    "m0_rad": Field(32, 2.0**-31 * GPS_PI, True),
    "eccentricity": Field(32, 2.0**-33),
    "cus_rad": Field(18, 2.0**-31, True),
    "crc_m": Field(18, 2.0**-6, True),
    "crs_m": Field(18, 2.0**-6, True),
    "sqrt_a_rm": Field(32, 2.0**-19),
    "toe_s": Field(17, 2.0**3),
    "i0_rad": Field(32, 2.0**-31 * GPS_PI, True),
    "cic_rad": Field(18, 2.0**-31, True),
    "omega_dot_radps": Field(24, 2.0**-43 * GPS_PI, True),
    "cis_rad": Field(18, 2.0**-31, True),
    "idot_radps": Field(14, 2.0**-43 * GPS_PI, True),
    "omega0_rad": Field(32, 2.0**-31 * GPS_PI, True),
    "omega_rad": Field(32, 2.0**-31 * GPS_PI, True),
    "leap_s": Field(8, 1.0, True),  # BDT − UTC
    "leap_future_s": Field(8, 1.0, True),
    "leap_week": Field(8),
    "a0_s": Field(32, 2.0**-30, True),
    "a1_sps": Field(24, 2.0**-50, True),
    "leap_day": Field(8),  # 0–6
}
"""Every number of the messages (BDS-SIS-ICD B1I tables 5-5 to 5-11, 5-17)."""

Layout = tuple[tuple[str, int], ...]
Page = tuple[int, int]  # number of the subframe, and page where subframes have pages

KLOBUCHAR_FIELDS: Final = tuple(f"{half}{n}" for half in ("alpha", "beta") for n in range(4))


def _whole(*names: str) -> Layout:
    """Fields that stand undivided."""
    return tuple((name, FIELDS[name].bits) for name in names)


_UTC_PAGE: Final = (
    ("", 1),
    *_whole("page", "leap_s", "leap_future_s", "leap_week", "a0_s", "a1_sps", "leap_day"),
)

D1_PAGES: Final[Mapping[Page, Layout]] = {  # from bit 39 of the information on
    (1, 0): _whole("health", "iodc", "ura_index", "week", "toc_s", "group_delay_s")
    + _whole("group_delay2_s", *KLOBUCHAR_FIELDS, "af2_sps2", "af0_s", "af1_sps", "iode"),
    (2, 0): _whole("delta_n_radps", "cuc_rad", "m0_rad", "eccentricity", "cus_rad", "crc_m")
    + (*_whole("crs_m", "sqrt_a_rm"), ("toe_s", 2)),
    (3, 0): (("toe_s", 15), *_whole("i0_rad", "cic_rad", "omega_dot_radps", "cis_rad"))
    + _whole("idot_radps", "omega0_rad", "omega_rad"),
    (5, 10): _UTC_PAGE,
}

D2_PAGES: Final[Mapping[Page, Layout]] = {
    (1, 1): _whole("d2_page", "health", "iodc", "ura_index", "week", "toc_s", "group_delay_s")
    + _whole("group_delay2_s"),
    (1, 2): _whole("d2_page", *KLOBUCHAR_FIELDS),
    (1, 3): (*_whole("d2_page"), ("", 38), *_whole("af0_s"), ("af1_sps", 4)),
    (1, 4): (*_whole("d2_page"), ("af1_sps", 18), *_whole("af2_sps2", "iode", "delta_n_radps"))
    + (("cuc_rad", 14),),
    (1, 5): (*_whole("d2_page"), ("cuc_rad", 4), *_whole("m0_rad", "cus_rad"))
    + (("eccentricity", 10),),
    (1, 6): (*_whole("d2_page"), ("eccentricity", 22), *_whole("sqrt_a_rm"), ("cic_rad", 10)),
    (1, 7): (*_whole("d2_page"), ("cic_rad", 8), *_whole("cis_rad", "toe_s"), ("i0_rad", 21)),
    (1, 8): (*_whole("d2_page"), ("i0_rad", 11), *_whole("crc_m", "crs_m"))
    + (("omega_dot_radps", 19),),
    (1, 9): (*_whole("d2_page"), ("omega_dot_radps", 5), *_whole("omega0_rad"))
    + (("omega_rad", 27),),
    (1, 10): (*_whole("d2_page"), ("omega_rad", 5), *_whole("idot_radps")),
    (5, 102): _UTC_PAGE,
}


def unpack(pages: Mapping[Page, Layout], information: Mapping[Page, int]) -> dict[str, float]:
    """Values of the fields of the pages at hand; a field spread over pages needs all of them."""
    raw: dict[str, int] = {}
    for page in sorted(information):
        at = INFORMATION_BITS - HEADER_BITS
        for name, length in pages[page]:
            at -= length
            raw[name] = raw.get(name, 0) << length | information[page] >> at & (1 << length) - 1
    values = {}
    for name in raw.keys() - {""}:
        bits, scale, signed = FIELDS[name]
        negative = signed and raw[name] >> (bits - 1)
        values[name] = (raw[name] - (1 << bits if negative else 0)) * scale
    return values


def pack(pages: Mapping[Page, Layout], page: Page, values: Mapping[str, float]) -> int:
    """The information of a page, header empty; what no field takes is 0."""
    left = {name: FIELDS[name].bits for name in FIELDS}
    for earlier in (p for p in sorted(pages) if p < page):
        for name, length in pages[earlier]:
            if name in left and length < left[name]:
                left[name] -= length
    information, at = 0, INFORMATION_BITS - HEADER_BITS
    for name, length in pages[page]:
        at -= length
        if name:
            left[name] -= length
            information |= (_raw(name, values[name]) >> left[name] & (1 << length) - 1) << at
    return information


def _raw(name: str, value: float) -> int:
    bits, scale, signed = FIELDS[name]
    raw = round(value / scale)
    low = -(1 << (bits - 1)) if signed else 0
    if not low <= raw < low + (1 << bits):
        raise NumericalError(f"BeiDou {name}: {value} needs more than {bits} bits of {scale:g}")
    return raw
