"""Synthetic nominal constellations: realistic orbits and clocks, nothing foreign in them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from deepgnss.core.errors import ConfigError
from deepgnss.core.records import NavData
from deepgnss.core.time import GpsTime
from deepgnss.sim.constellation.beidou import KLOBUCHAR as BEIDOU_KLOBUCHAR
from deepgnss.sim.constellation.beidou import nominal_beidou
from deepgnss.sim.constellation.gps import KLOBUCHAR, nominal_gps

__all__ = ["BEIDOU_KLOBUCHAR", "KLOBUCHAR", "nominal", "nominal_beidou", "nominal_gps"]

_MAKERS: Final[Mapping[str, Callable[[GpsTime, float], NavData]]] = {
    "G": nominal_gps,
    "C": nominal_beidou,
}


def nominal(start: GpsTime, seconds: float, systems: str = "G") -> NavData:
    """All satellites of systems (letters, e.g. "GC"), with the sets in force from `start` on.

    UTC is one for all. Raises ConfigError for a letter without a constellation.
    """
    unknown = sorted(set(systems) - _MAKERS.keys())
    if unknown or not systems:
        raise ConfigError(
            f"systems: '{systems}': a nominal constellation is there for {', '.join(_MAKERS)}"
        )
    parts = [_MAKERS[letter](start, seconds) for letter in sorted(set(systems), reverse=True)]
    return NavData(
        ephemerides={name: sets for part in parts for name, sets in part.ephemerides.items()},
        klobuchar={name: model for part in parts for name, model in part.klobuchar.items()},
        utc=parts[0].utc,
    )
