"""Arcs: phases followed from tag to tag, and what becomes of one that stops fitting.

An arc is a stretch of a satellite's phase without a possible slip. Over it code less phase is a
constant, but for the code's noise and reflections.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

_WINDOW_S: Final = 0.45  # for which a phase that was left out is looked at before it is judged, …
_LATEST_S: Final = 1.5  # … and after which it is, settled or not
_LAST: Final = 3  # tags that judge
_SETTLED_CYCLES: Final = 0.1  # by which they differ once a loop has slipped
_LEFT_CYCLES: Final = 0.12  # of a slip beyond a multiple of half a cycle …
_CERTAIN: Final = 4.0  # … and σ that fit between that and a quarter of a cycle
_NARROW_S: Final = 5.0  # after which a code loop is narrow
_KNOWN_S: Final = 3.0  # of an arc before its code less phase is known …
_AVERAGED_S: Final = 60.0  # … and of the narrow loop's codes that count at most
_CODE_M: Final = 0.2  # 1σ of a narrow loop's code at 45 dB-Hz
_FAR: Final = (0.5, 4.0)  # m, and σ of it, by which a code is no longer that of its phase

Name = tuple[str, int]
"""Satellite and number of the arc."""

REST: Final[tuple[Name, ...]] = (("north", -1), ("east", -1), ("down", -1))
"""An antenna at rest is like three phases along the axes that do not change."""


class Slip(NamedTuple):
    """A satellite whose phase does not go on as before."""

    satellite: str
    cycles: float | None  # too much in the phase; None: nobody knows
    reason: str


@dataclass(slots=True)
class CodeLessPhase:
    """Their mean over an arc, m: a code loop says the more the longer it has narrowed."""

    mean_m: float = 0.0
    weight_s: float = 0.0  # of tags

    def take(self, one_m: float, age_s: float, seconds: float) -> None:
        """Take in that of a tag, so long after the arc began and after the tag before."""
        weight_s = min(age_s / _NARROW_S, 1.0) ** 2 * seconds
        if weight_s > 0.0:
            self.weight_s = min(self.weight_s + weight_s, _AVERAGED_S)
            self.mean_m += weight_s / self.weight_s * (one_m - self.mean_m)

    @property
    def known(self) -> bool:
        """Whether it says more than a code loop that has just begun."""
        return self.weight_s > _KNOWN_S**3 / (3.0 * _NARROW_S**2)

    def off_m(self, one_m: float, cn0_dbhz: float) -> float:
        """By how much a code is too long for its phase; 0 within what its noise explains."""
        least_m, sigmas = _FAR
        off_m = one_m - self.mean_m
        if not self.known or abs(off_m) <= least_m:
            return 0.0
        limit_m = math.hypot(least_m, sigmas * _CODE_M * 10.0 ** ((45.0 - cn0_dbhz) / 20.0))
        return off_m if abs(off_m) > limit_m else 0.0


@dataclass(slots=True)
class Arc:
    """A phase being followed, in metres once its clock and its unit are taken off."""

    name: Name
    wavelength_m: float
    heard_s: float  # last tag at which there was one
    began_s: float
    believed_s: float  # last tag at which it agreed with all others
    range_m: float = 0.0  # predicted since it began
    upright: bool = False  # its half cycle is known
    back: bool = False  # at its last tag it was, behind a gap
    past: bool = False  # it has ended, and is kept for the satellite's next one …
    misfits: int = 0  # … to which it did not fit at so many tags
    code: CodeLessPhase = field(default_factory=CodeLessPhase)
    doubted_s: float = math.nan  # since when it does not agree …
    off_cycles: list[float] = field(default_factory=list)  # … and by how much, tag by tag

    def trust(self) -> None:
        """It agrees (again)."""
        self.doubted_s, self.off_cycles = math.nan, []


class Verdict(NamedTuple):
    """What a phase that was left out for a while turned out to be; no slip: it only drifted."""

    slip: Slip | None


def verdict(arc: Arc, now_s: float, off_m: float, sigma_m: float) -> Verdict | None:
    """Judge a phase that does not agree once its loop has settled; None: not yet."""
    if arc.name in REST:
        return Verdict(None)
    if math.isnan(arc.doubted_s):
        arc.doubted_s = now_s
    arc.off_cycles = [*arc.off_cycles[1 - _LAST :], off_m / arc.wavelength_m]
    waited_s = now_s - arc.doubted_s
    if waited_s < _WINDOW_S:
        return None
    off, sigma = float(np.mean(arc.off_cycles)), sigma_m / arc.wavelength_m
    settled = max(arc.off_cycles) - min(arc.off_cycles) < _SETTLED_CYCLES
    if not settled and waited_s < _LATEST_S:
        return None
    slipped = round(2.0 * off) / 2.0
    left = abs(off - slipped)
    told = f"{off:+.2f} cycles off for {waited_s:.1f} s, sigma {sigma:.2f}"
    if settled and left < _LEFT_CYCLES and left + _CERTAIN * sigma < 0.25:
        return Verdict(Slip(arc.name[0], slipped, told) if slipped else None)
    return Verdict(Slip(arc.name[0], None, told) if abs(off) > 0.25 else None)
