"""Carrier frequencies by what RINEX calls them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS

CARRIERS_HZ: Final[Mapping[str, Mapping[str, float]]] = {
    "G": {"1": 1_575.42e6, "2": 1_227.60e6, "5": 1_176.45e6},
    "C": {
        **{"2": 1_561.098e6, "1": 1_575.42e6, "5": 1_176.45e6},
        **{"7": 1_207.14e6, "6": 1_268.52e6, "8": 1_191.795e6},
    },
}
"""By system letter and digit of the band, the system's first signal first (RINEX 3.05 tables 4
and 9)."""


def band_wavelength_m(system: str, band: str) -> float:
    """Carrier wavelength of a system's band."""
    return SPEED_OF_LIGHT_MPS / CARRIERS_HZ[system][band]
