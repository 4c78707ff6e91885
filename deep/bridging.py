"""What carries phase, clock and trust from tag to tag: carrier phases against the navigation.

Every phase whose arc goes on is held against the range change the inertial navigation predicts,
all in one filter (`phase_filter`). It finds cycle slips, knows the receiver's clock, and says what
the phase of a channel in open loop is by now and how well that is known. Nothing of it reaches a
channel whose signal is there, except that a slip of its own is told to it.

Signs: phases grow with range; a slip of n cycles is n too much in the phase.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS, STANDARD_GRAVITY_MPS2
from deepgnss.core.errors import NumericalError
from deepgnss.core.jit import brief_kernel
from deepgnss.core.records import SIGNAL_IDS, FloatArray, Observation, Oscillator
from deepgnss.deep.aiding import Skyline
from deepgnss.deep.arcs import REST, Arc, Name, Slip, verdict
from deepgnss.deep.navigation import Leg
from deepgnss.deep.phase_filter import Chosen, PhaseFilter, common_jump, sound
from deepgnss.deep.rejoining import Return, rejoin
from deepgnss.ins.error_model import VELOCITY
from deepgnss.ins.increments import SAME_INSTANT_S
from deepgnss.receiver.modes import Coast
from deepgnss.theory.tracking_error import pll_thermal_sigma_cycles

_LIMIT: Final = 4.0  # σ from which a phase is left out
_OUTSIDE: Final = 5.0  # σ from which it is not told either
_JUMP: Final = 5.0  # σ from which what most have in common is a jump
_MANY: Final = 5  # phases whose agreement says more than the navigation
_WALK_MPRTS: Final = 3e-4  # of an arc's own error: satellite clocks
_UNMODELLED: Final = (1e-4, 0.3)  # 1σ of a rate: m/s, and share of the atmosphere's …
_LASTING_S: Final = 300.0  # … and for how long it is the same: waves of the ionosphere
_REST_M: Final = 1e-3  # by which an antenna at rest moves
_MANOEUVRE_S: Final = 1.0  # for which a force on the oscillator lasts
_STALE_S: Final = 2.0  # for an arc not heard of, and for a skyline
_WORSE: Final = 4.0  # variance of velocity against the navigation's own: that knows better
_DRIFT_SIGMA_MPS: Final = 1.0  # at the start, where Doppler tells the drift …
_UNKNOWN_DRIFT_MPS: Final = 1e3  # … and where not
_PHASES_ENOUGH: Final = 4  # with fewer, the drift by Doppler counts
_GAP: Final = 1.5  # intervals of tags without a phase: its code loop has begun anew
_MISFITS: Final = 10  # tags at which new arcs do not fit the one before: it is given up

_LOST: Final = Coast(0.0, math.inf)


class Loop(NamedTuple):
    """What the noise of a tracked phase follows from."""

    bandwidth_hz: float
    coherent_s: float
    floor_cycles: float  # 1σ beside the thermal noise

    def sigma_cycles(self, cn0_dbhz: float, interval_s: float) -> float:
        """1σ of phases an interval apart, as if they were independent of each other."""
        thermal = pll_thermal_sigma_cycles(cn0_dbhz, self.bandwidth_hz, self.coherent_s)
        alike = max(1.0, 0.5 / (self.bandwidth_hz * interval_s))
        return math.hypot(thermal, self.floor_cycles) * math.sqrt(alike)


class Tag(NamedTuple):
    """What there is at a tag, and the leg that led to it."""

    observations: Sequence[Observation]
    coasting: Sequence[Observation]
    model_s: float  # error of the counter by the clock model at the tag
    drift: tuple[float, float]  # of the receiver's clock by Doppler and its 1σ, s/s; NaN: unknown
    leg: Leg
    P: FloatArray  # of the vehicle's errors by the navigation, after the tag's correction
    C_ne: FloatArray  # (3, 3)
    refused: Container[str] = ()  # satellites whose range is known to be wrong


class Bridged(NamedTuple):
    """What a tag gave."""

    moves: Mapping[str, Coast] = {}
    slips: tuple[Slip, ...] = ()
    clock_jump_m: float | None = None
    halves: Mapping[str, int] = {}  # cycles too much in new arcs whose polarity is known by it, × 2
    joined_m: Mapping[str, float] = {}  # by which codes are too long where a phase goes on …
    bent_m: Mapping[str, float] = {}  # … and where they follow a reflection
    outside: frozenset[str] = frozenset()  # satellites whose phases all others contradict


class _Seen(NamedTuple):
    """A phase of a tag."""

    phase_m: float
    sigma_m: float
    wavelength_m: float
    code_m: float = 0.0  # less phase
    cn0_dbhz: float = 0.0
    upright: bool = True  # its half cycle is known
    sound: bool = True  # its range is not known to be wrong


class _Sights(NamedTuple):
    """Where arcs come from."""

    rate_mps: FloatArray  # (k,) of the range to a resting antenna
    toward_n: FloatArray  # (k, 3)
    clocked: FloatArray  # (k,) 1: the receiver's clock is in it


class Bridge:
    """Follows the phases of all satellites from tag to tag while the navigation runs."""

    def __init__(self, oscillator: Oscillator, loop: Loop) -> None:
        self._oscillator = oscillator
        self._loop = loop
        self._filter: PhaseFilter | None = None
        self._arcs: list[Arc] = []  # in the filter's order
        self._model_m = 0.0  # error of the counter by the clock model
        self._now_s = math.nan

    @property
    def drift_sps(self) -> float | None:
        """Frequency error of the receiver's oscillator, None while nobody knows."""
        return None if self._filter is None else self._filter.drift_mps / SPEED_OF_LIGHT_MPS

    @property
    def drift_mps(self) -> tuple[float, float] | None:
        """The same times c, and its 1σ."""
        known = self._filter
        return None if known is None else (known.drift_mps, known.drift_sigma_mps)

    @property
    def velocity_error_n_mps(self) -> FloatArray | None:
        """What the phases say of the navigation's velocity (NED), estimate − truth."""
        return None if self._filter is None else self._filter.velocity_error_n_mps

    @property
    def errors_covariance(self) -> FloatArray | None:
        """Of the navigation's errors but position, as the phases leave it."""
        return None if self._filter is None else self._filter.errors_covariance

    def rate_sigma_mps(
        self, satellites: Sequence[str], skyline: Skyline, C_ne: FloatArray
    ) -> FloatArray | None:
        """1σ of the rates predicted for satellites of a skyline; None without a navigation."""
        if self._filter is None:
            return None
        _, toward_e = skyline.sights.at(self._now_s)
        return self._filter.rate_sigma_mps(
            toward_e[0, [skyline.row[satellite] for satellite in satellites]] @ C_ne.T
        )

    def stop(self, coasting: Iterable[Observation] = ()) -> Bridged:
        """There is no navigation: nothing is carried on."""
        self._filter, self._arcs = None, []
        return Bridged({one.satellite: _LOST for one in coasting if one.carrier_valid})

    def take(self, tag: Tag, skyline: Skyline) -> Bridged:
        """Go on to a tag: what it says of slips, and how channels in open loop are to be moved."""
        try:
            return self._take(tag, skyline)
        except NumericalError:
            return self.stop(tag.coasting)

    def _take(self, tag: Tag, skyline: Skyline) -> Bridged:
        leg = tag.leg
        if self._filter is None or abs(leg.begin_s - self._now_s) > SAME_INSTANT_S:
            self._filter, self._arcs = self._started(tag), []
        else:
            self._carry(self._filter, tag, skyline)
        self._now_s, self._model_m = leg.end_s, SPEED_OF_LIGHT_MPS * tag.model_s
        known, seen = self._filter, self._seen(tag)
        sights = self._sights(skyline, leg.end_s, tag.C_ne)
        jump_m, slips, outside = self._believe(known, tag, seen, sights)
        for _, z_mps, H, R, *_ in leg.rolled:
            known.take_velocities(z_mps, H, np.diagonal(R))
        if self._begin(known, tag, seen, skyline):
            sights = self._sights(skyline, leg.end_s, tag.C_ne)
        known.shift(leg.correction)
        if known.velocity_variance_m2ps2 > _WORSE * np.trace(tag.P[VELOCITY, VELOCITY]):
            known.restart_errors(tag.P)
        known.rest_way(sights.toward_n)
        moves = self._moves(known, tag.coasting, sights)
        bent_m = self._bent_codes(seen)
        halves, joined_m = self._rejoin(known, seen, sights, bent_m)
        return Bridged(moves, slips, jump_m, halves, joined_m, bent_m, outside)

    # --- from the tag before to this one -------------------------------------------------------

    def _started(self, tag: Tag) -> PhaseFilter:
        drift_sps, _ = tag.drift
        known = math.isfinite(drift_sps)
        return PhaseFilter(
            tag.P,
            self._oscillator,
            drift_sps * SPEED_OF_LIGHT_MPS if known else 0.0,
            _DRIFT_SIGMA_MPS if known else _UNKNOWN_DRIFT_MPS,
        )

    def _carry(self, known: PhaseFilter, tag: Tag, skyline: Skyline) -> None:
        """Predicted ranges and the filter over a leg; arcs nobody can predict end."""
        leg = tag.leg
        seconds = leg.end_s - leg.begin_s
        fresh = abs(leg.end_s - float(skyline.sights.time_s[1])) < _STALE_S
        self._keep(
            known,
            [arc.name in REST or (fresh and arc.name[0] in skyline.row) for arc in self._arcs],
        )
        sights = self._sights(skyline, 0.5 * (leg.begin_s + leg.end_s), tag.C_ne)
        longer_m = seconds * sights.rate_mps - sights.toward_n @ (tag.C_ne @ leg.moved_e_m)
        for arc, one_m in zip(self._arcs, longer_m.tolist(), strict=True):
            arc.range_m += one_m
        walk_mps = _UNMODELLED[0] * math.sqrt(2.0 * seconds / _LASTING_S)
        force_g = float(np.linalg.norm(leg.gained_e_mps)) / seconds / STANDARD_GRAVITY_MPS2
        shaken_mps = SPEED_OF_LIGHT_MPS * self._oscillator.g_sensitivity * force_g
        known.carry(
            leg.H_begin,
            leg.H_end,
            leg.Phi,
            leg.Q,
            seconds,
            clock_shaken_m2=shaken_mps**2 * 2.0 * _MANOEUVRE_S * seconds,
            arcs_walk_m2=_WALK_MPRTS**2 * seconds,
            rates_walk_m2ps2=walk_mps**2 * sights.clocked,
        )

    def _sights(self, skyline: Skyline, time_s: float, C_ne: FloatArray) -> _Sights:
        """Where the arcs come from at an instant; axes of rest stay themselves."""
        rows = [skyline.row.get(arc.name[0], -1) for arc in self._arcs]
        sights = _Sights(*_seen_from(*skyline.sights, np.array(rows, dtype=np.int64), time_s, C_ne))
        for k, row in enumerate(rows):
            if row < 0 and self._arcs[k].name in REST:
                sights.toward_n[k, REST.index(self._arcs[k].name)] = 1.0
        return sights

    def _keep(self, known: PhaseFilter, kept: Sequence[bool]) -> None:
        if not all(kept):
            known.keep(np.array(kept, dtype=np.bool_))
            self._arcs = [arc for arc, stays in zip(self._arcs, kept, strict=True) if stays]

    # --- phases of a tag -----------------------------------------------------------------------

    def _seen(self, tag: Tag) -> dict[Name, _Seen]:
        """Phases in metres, freed of the clock model."""
        seconds, found = tag.leg.end_s - tag.leg.begin_s, {}
        for one in tag.observations:
            if one.carrier_valid:
                wavelength_m = SPEED_OF_LIGHT_MPS / SIGNAL_IDS[one.signal].carrier_hz
                found[one.satellite, one.arc] = _Seen(
                    one.carrier_cycles * wavelength_m + self._model_m,
                    self._loop.sigma_cycles(one.cn0_dbhz, seconds) * wavelength_m,
                    wavelength_m,
                    one.pseudorange_m - one.carrier_cycles * wavelength_m,
                    one.cn0_dbhz,
                    not one.half_cycle,
                    one.satellite not in tag.refused,
                )
        if tag.leg.at_rest:
            found |= dict.fromkeys(REST, _Seen(0.0, _REST_M, 1.0, sound=False))
        return found

    def _believe(
        self, known: PhaseFilter, tag: Tag, seen: Mapping[Name, _Seen], sights: _Sights
    ) -> tuple[float | None, tuple[Slip, ...], frozenset[str]]:
        """Take in the phases that agree with the prediction and with each other; judge the rest."""
        now_s = tag.leg.end_s
        rows = [k for k, arc in enumerate(self._arcs) if arc.name in seen]
        H = known.rows(sights.toward_n, sights.clocked)[rows]
        arcs = [self._arcs[k] for k in rows]
        y_m = np.array([seen[arc.name].phase_m - arc.range_m for arc in arcs])
        variance_m2 = np.array([seen[arc.name].sigma_m ** 2 for arc in arcs])
        kept, jump_m = self._agreeing(known, tag, H, y_m, variance_m2)
        known.update(H[kept], y_m[kept], variance_m2[kept])
        if np.sum(sights.clocked[rows] * kept) < _PHASES_ENOUGH and math.isfinite(tag.drift[0]):
            known.take_drift(*(SPEED_OF_LIGHT_MPS * value for value in tag.drift))
        seconds = now_s - tag.leg.begin_s
        for arc, agrees in zip(arcs, kept, strict=True):
            arc.heard_s = now_s
            if agrees:
                unseen_s = now_s - arc.believed_s
                arc.back = arc.code.known and unseen_s > _GAP * seconds
                arc.believed_s = now_s
                arc.trust()
                self._average(arc, seen[arc.name], seconds)
        if kept.all():
            return jump_m, (), frozenset()
        off_m, covariance = known.innovation(H, y_m, variance_m2)
        far = ~kept & (np.abs(off_m) > _OUTSIDE * np.sqrt(np.diagonal(covariance)))
        outside = frozenset(arc.name[0] for arc, one in zip(arcs, far, strict=True) if one)
        slips = []
        for k, arc in enumerate(arcs):
            if kept[k]:
                continue
            found = verdict(arc, now_s, float(off_m[k]), math.sqrt(covariance[k, k]))
            if found is None:
                continue
            arc.trust()
            slip = found.slip
            if slip is None or slip.cycles is None:
                known.open_arc(rows[k], float(off_m[k]) ** 2)
            if slip is not None:
                slips.append(slip)
        return jump_m, tuple(slips), outside

    def _agreeing(
        self, known: PhaseFilter, tag: Tag, H: FloatArray, y_m: FloatArray, variance_m2: FloatArray
    ) -> tuple[Chosen, float | None]:
        """Phases that fit, and by how much the clock has jumped.

        A step of the clock, or of the navigation's way, that most phases show is none of theirs.
        """
        off_m, covariance = known.innovation(H, y_m, variance_m2)
        jump_m = common_jump(off_m, covariance, _JUMP)
        if jump_m is not None:
            known.open_clock(jump_m)
            off_m, covariance = known.innovation(H, y_m, variance_m2)
        kept = sound(off_m, covariance, _LIMIT)
        if y_m.size < _MANY or 2 * np.sum(kept) >= y_m.size:
            return kept, jump_m
        step_m2 = float(np.max(off_m**2))
        alike = sound(off_m, covariance + step_m2 * known.common(H), _LIMIT)
        if np.sum(alike) < max(_MANY, 0.6 * y_m.size):
            return kept, jump_m
        known.open_way(step_m2)
        known.restart_errors(tag.P)
        return alike, jump_m

    def _begin(
        self, known: PhaseFilter, tag: Tag, seen: Mapping[Name, _Seen], skyline: Skyline
    ) -> bool:
        """New arcs begin at the tag, those nobody hears of any more have ended; any of these."""
        now_s = tag.leg.end_s
        told = {(one.satellite, one.arc) for one in tag.coasting if one.carrier_valid} | seen.keys()
        others = {satellite for satellite, _ in told}
        for arc in self._arcs:
            if arc.name in told:
                arc.heard_s = now_s
        ended = [
            arc.name not in told
            and (arc.name in REST or arc.name[0] in others or now_s - arc.heard_s >= _STALE_S)
            for arc in self._arcs
        ]
        if any(ended):
            self._lay_by([arc for arc, over in zip(self._arcs, ended, strict=True) if over])
            self._keep(
                known, [arc.past or not over for arc, over in zip(self._arcs, ended, strict=True)]
            )
        there = {arc.name for arc in self._arcs}
        fresh = [
            name for name in seen if name not in there and (name in REST or name[0] in skyline.row)
        ]
        if not fresh:
            return any(ended)
        first = len(self._arcs)
        self._arcs += [
            Arc(name, seen[name].wavelength_m, now_s, now_s, now_s, upright=seen[name].upright)
            for name in fresh
        ]
        sights = self._sights(skyline, now_s, tag.C_ne)
        known.begin(
            np.array([seen[name].phase_m for name in fresh]),
            np.array([seen[name].sigma_m ** 2 for name in fresh]),
            np.square([_unmodelled_mps(name, skyline) for name in fresh]),
            sights.toward_n[first:],
            sights.clocked[first:],
        )
        return True

    # --- one arc after the other ---------------------------------------------------------------

    @staticmethod
    def _average(arc: Arc, seen: _Seen, seconds: float) -> None:
        """Take in what a phase that is believed says of its arc."""
        arc.upright |= seen.upright
        if seen.sound and not arc.back and not arc.code.off_m(seen.code_m, seen.cn0_dbhz):
            arc.code.take(seen.code_m, arc.believed_s - arc.began_s, seconds)

    def _lay_by(self, ended: Iterable[Arc]) -> None:
        """Keep arcs that have ended for the satellite's next one: the last that is good for it."""
        for arc in ended:
            if not arc.past and arc.upright and arc.code.known:
                for other in self._arcs:
                    other.past &= other.name[0] != arc.name[0]
                arc.past = True
            elif arc.misfits >= _MISFITS:
                arc.past = False

    def _rejoin(
        self,
        known: PhaseFilter,
        seen: Mapping[Name, _Seen],
        sights: _Sights,
        bent: Container[str],
    ) -> tuple[dict[str, int], dict[str, float]]:
        """Go on with arcs of satellites that are back: half cycles, and codes that are too long."""
        before = {arc.name[0]: k for k, arc in enumerate(self._arcs) if arc.past}
        back = [
            Return(
                arc,
                self._arcs[k],
                place,
                k,
                seen[arc.name].code_m,
                seen[arc.name].sound and arc.name[0] not in bent,
            )
            for place, arc in enumerate(self._arcs)
            if not arc.past
            and arc.believed_s == self._now_s
            and (k := before.get(arc.name[0])) is not None
            and (arc.upright or (seen[arc.name].sound and arc.name[0] not in bent))
        ]
        halves: dict[str, int] = {}
        off_m = {
            arc.name[0]: seen[arc.name].code_m - arc.code.mean_m
            for arc in self._arcs
            if arc.back and arc.believed_s == self._now_s
        }
        for (arc, past, place, *_), number in (joined := rejoin(known, back)):
            satellite, step_m = arc.name[0], 0.5 * number * arc.wavelength_m
            past.code.mean_m -= step_m
            off_m[satellite] = seen[arc.name].code_m - past.code.mean_m
            if not arc.upright:
                halves[satellite] = number
                if number % 2:  # it is told with half a cycle more from now on
                    arc.name = satellite, arc.name[1] + 1
                    known.raise_arc(place, 0.5 * arc.wavelength_m)
                    past.code.mean_m -= 0.5 * arc.wavelength_m
            arc.upright, arc.code = True, past.code
        over = {one.back.place_before for one in joined}
        self._keep(known, [k not in over for k in range(len(self._arcs))])
        return halves, off_m

    def _bent_codes(self, seen: Mapping[Name, _Seen]) -> dict[str, float]:
        """Codes that have left their phase, a believed one, by more than noise: reflections."""
        return {
            arc.name[0]: off_m
            for arc in self._arcs
            if arc.name in seen
            and arc.believed_s == self._now_s
            and not arc.back
            and (off_m := arc.code.off_m(seen[arc.name].code_m, seen[arc.name].cn0_dbhz))
        }

    # --- open loop -----------------------------------------------------------------------------

    def _moves(
        self, known: PhaseFilter, coasting: Sequence[Observation], sights: _Sights
    ) -> dict[str, Coast]:
        """By how much the phases carried on are off, and how well that is known."""
        asked = [one for one in coasting if one.carrier_valid]
        if not asked:
            return {}
        H = known.rows(sights.toward_n, sights.clocked)
        y_m = H @ known.mean
        variance_m2 = np.einsum("ki,ij,kj->k", H, known.P, H)
        place = {arc.name: k for k, arc in enumerate(self._arcs)}
        moves = {}
        for one in asked:
            k = place.get((one.satellite, one.arc))
            if k is None:
                moves[one.satellite] = _LOST
                continue
            arc = self._arcs[k]
            phase_m = y_m[k] + arc.range_m - self._model_m
            moves[one.satellite] = Coast(
                float(phase_m / arc.wavelength_m - one.carrier_cycles),
                math.sqrt(variance_m2[k]) / arc.wavelength_m,
            )
        return moves


@brief_kernel
def _seen_from(
    ends_s: FloatArray,
    rate_mps: FloatArray,
    toward_e: FloatArray,
    rows: NDArray[np.int64],
    time_s: float,
    C_ne: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fields of `_Sights` at an instant, by those at the ends of an epoch; rows (k,), −1: none."""
    share = (time_s - ends_s[0]) / (ends_s[1] - ends_s[0])
    rates, towards, clocked = np.zeros(rows.size), np.zeros((rows.size, 3)), np.zeros(rows.size)
    for k in range(rows.size):
        row = rows[k]
        if row >= 0:
            rates[k] = rate_mps[0, row] + share * (rate_mps[1, row] - rate_mps[0, row])
            towards[k] = toward_e[0, row] + share * (toward_e[1, row] - toward_e[0, row])
            clocked[k] = 1.0
    return rates, towards @ C_ne.T, clocked


def _unmodelled_mps(name: Name, skyline: Skyline) -> float:
    """1σ of the rate predicted for an arc."""
    if name in REST:
        return 0.0
    floor_mps, share = _UNMODELLED
    return math.hypot(floor_mps, share * float(skyline.delay_rate_mps[skyline.row[name[0]]]))
