"""Guards the loops against their own aid: trust, the log's time offset, and what to tell the user.

Stands beside the navigation and reads along: innovations go to the watch, fixes to the estimate of
the time offset. The receiver is aided only while the guard trusts the navigation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from deepgnss.core.records import FloatArray, ImuBlock, ImuGrade
from deepgnss.core.time import GpsTime
from deepgnss.deep.navigation import NavigationState, lasting_doppler_s
from deepgnss.deep.time_offset import CarrierLoop, Offset, OffsetEstimator, fit_stretch
from deepgnss.deep.watch import (
    FASTEST_SIGMA_MPS,
    Turn,
    Watch,
    bias_finding,
    travel_finding,
    turn_on_finding,
)
from deepgnss.ins import Estimate, fix_of
from deepgnss.ins.fixes import GnssFix
from deepgnss.ins.integration import InsEvent
from deepgnss.ins.turn_on import turn_on
from deepgnss.ins.updates import Innovation
from deepgnss.receiver.receiver import Fix

_MOVING_MPS = 3.0
_LONG_S = 30.0  # of motion without an attitude: said
_LONG_SHARE = 0.4  # of the time navigated, without trust: said …
_SOME_SHARE = 0.1  # … where it is known why
_RESTED_S = 3.0  # from the log's beginning to a fix that says whether it began at rest
_FITS = 2  # stretches that go with the fixes once biases are free
_SIDEWAYS = "off the body's forward axis"  # what an alignment says of wrong axes
_SIDEWAYS_S, _SIDEWAYS_OFTEN = 120.0, 3  # so often within so long, no attitude is trusted
_CORRECTED_S = 0.002  # the least that is worth a new start …
_CORRECTED_SIGMAS = 3.0  # … and the least that is sure


class Unit(NamedTuple):
    """The inertial unit as its settings describe it."""

    grade: ImuGrade
    lever_b_m: FloatArray
    mounting_yaw_rad: float
    time_offset_s: float | None  # of the settings; None: `auto`


class Guard:
    """What an epoch gave goes in; trust, events, and offsets to take off come out."""

    def __init__(self, unit: Unit, loop: CarrierLoop) -> None:
        self._unit = unit
        self._watch = Watch()
        self._offsets = OffsetEstimator(unit.grade, unit.lever_b_m, loop)
        self._taken_off_s = 0.0
        self._taken_off_at_s: float | None = None  # since the first fix
        self._first: GpsTime | None = None
        self._last: GpsTime | None = None
        self._trusted_s = self._navigated_s = self._moving_s = 0.0
        self._block: ImuBlock | None = None
        self._estimate: Estimate | None = None
        self._sideways: list[float] = []  # when it moved off its forward axis, s of the log
        self._doubt = ""  # why trust was lost first
        self._unaligned = ""  # why there is no attitude
        self._began: str | None = None  # what is wrong with the biases of its start; None: unseen

    @property
    def trusted(self) -> bool:
        """Whether the loops may be aided."""
        return self._watch.trusted

    @property
    def offset(self) -> Offset:
        """How late the log is against its own settings, all told."""
        return self._offsets.offset.moved(self._taken_off_s)

    def take(
        self,
        block: ImuBlock,
        fixes: Sequence[Fix],
        states: Sequence[NavigationState],
        told: Sequence[InsEvent],
        innovations: Sequence[Innovation],
        *,
        aided: bool,
    ) -> list[Turn]:
        """Read along with an epoch; where trust began or ended.

        block: the log as it is used. aided: whether the loops were, in this epoch.
        """
        self._block = block
        if any(event.what == "started" for event in told):
            self._watch.restart(contradicted=False)
        sigma_mps = np.inf
        if states:
            sigma_mps = float(np.sqrt(np.trace(states[-1].antenna.covariance[3:, 3:]) / 3.0))
            self._estimate = states[-1].estimate
        self._sideways += [e.time_s for e in told if _SIDEWAYS in e.reason]
        now_s = told[-1].time_s if told else -np.inf
        self._sideways = [at_s for at_s in self._sideways if now_s - at_s < _SIDEWAYS_S]
        if len(self._sideways) >= _SIDEWAYS_OFTEN:  # an attitude found by course alone means little
            sigma_mps = np.inf
        stands_s = max((lasting_doppler_s(fix) for fix in fixes), default=0.0)
        turns = self._watch.take(innovations, sigma_mps, stands_s)
        for event in told:
            if event.what == "stopped":
                contradicted = "innovation" in event.reason
                self._doubt = self._doubt or (event.reason if contradicted else "")
                self._watch.restart(contradicted=contradicted)
            self._unaligned = event.reason if event.what == "not aligned" else self._unaligned
        for turn in turns:
            self._doubt = self._doubt or ("" if turn.trusted else turn.reason)
        for fix in fixes:
            self._count(fix, bool(states))
            if fix.solution.valid and np.isfinite(fix.solution.v_e_mps).all():
                gnss = fix_of(fix.solution)
                self._begin(block, gnss)
                self._offsets.take(block, gnss, aided=aided)
        return turns

    def _begin(self, block: ImuBlock, fix: GnssFix) -> None:
        """Look at the log's beginning, once there is a fix to say whether it rested."""
        since_s = fix.time.since(block.origin.plus(float(block.time_s[0])))
        sure = fix.velocity_sigma_mps <= FASTEST_SIGMA_MPS and since_s >= _RESTED_S
        if self._began is None and sure:
            biases = turn_on(block, fix, self._unit.grade)
            self._began = "" if biases is None else turn_on_finding(biases, self._unit.grade)

    def _count(self, fix: Fix, navigated: bool) -> None:
        time, last = fix.epoch.time, self._last
        self._first, self._last = self._first or time, time
        passed_s = time.since(last) if last is not None else 0.0
        self._navigated_s += passed_s * navigated
        self._trusted_s += passed_s * (navigated and self.trusted)
        solution = fix.solution
        moving = solution.valid and float(np.linalg.norm(solution.v_e_mps)) > _MOVING_MPS
        self._moving_s += passed_s * (moving and not navigated)

    def correction_s(self) -> float | None:
        """What is to be added to the log's times now; None: nothing, or nobody asked for it."""
        if self._unit.time_offset_s is not None:
            return None
        late = self._offsets.offset
        least_s = max(_CORRECTED_S, _CORRECTED_SIGMAS * late.sigma_s)
        return -late.late_s if late.sure and abs(late.late_s) > least_s else None

    def corrected(self, seconds: float) -> None:
        """The log's times have been moved."""
        self._offsets.shifted(seconds)
        self._taken_off_s -= seconds
        if self._first is not None and self._last is not None:
            self._taken_off_at_s = self._last.since(self._first)
        self._watch.restart(contradicted=False)

    # --- what to tell ------------------------------------------------------------------------

    def summary(self) -> dict[str, Any]:
        """For `summary.json`."""
        offset = self.offset
        known = offset.stretches > 0 and bool(np.isfinite(offset.sigma_s))
        return {
            "navigated_s": round(self._navigated_s, 3),
            "trusted_s": round(self._trusted_s, 3),
            "late_s": offset.late_s if known else None,
            "late_sigma_s": offset.sigma_s if known else None,
            "taken_off_s": self._taken_off_s if self._unit.time_offset_s is None else None,
            "warnings": self.warnings(),
        }

    def line(self) -> str:
        """For the screen's summary."""
        offset = self.offset
        known = offset.stretches > 0 and bool(np.isfinite(offset.sigma_s))
        return (
            f"aided the loops in {self._trusted_s:.1f} of {self._navigated_s:.1f} s navigated;"
            f" log {offset if known else 'of unknown delay'}"
        )

    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the log, as far as it can be told; one line, or none."""
        offset, asked = self.offset, self._unit.time_offset_s
        lines = []
        untrusted_s = self._navigated_s - self._trusted_s
        share = untrusted_s / max(self._navigated_s, 1e-9)
        cause = self._cause() if self._doubt and share > _SOME_SHARE else ""
        if self._doubt and share > (_SOME_SHARE if cause else _LONG_SHARE):
            cause = cause or "its axes, scale, or drive are not those of this recording"
            lines.append(
                f"inertial log contradicts the satellites, no aiding for {untrusted_s:.1f} of"
                f" {self._navigated_s:.1f} s: {cause} ({self._doubt})"
            )
        elif self._moving_s > _LONG_S and self._moving_s > self._navigated_s:
            cause = self._travel() or self._unaligned
            lines.append(f"inertial log: no attitude in {self._moving_s:.0f} s of motion: {cause}")
        elif (bias := self._bias()) != "":
            lines.append(f"inertial log: {bias}")
        if asked is not None and offset.significant and not lines:
            lines.append(
                f"inertial log seems {offset}: set imu.time_offset: {asked - offset.late_s:.3f}"
                " or auto"
            )
        elif asked is None and self._taken_off_at_s is not None:
            lines.append(
                f"inertial log was {offset}: imu.time_offset: auto took"
                f" {self._taken_off_s:+.3f} s off, last after {self._taken_off_at_s:.1f} s"
            )
        return tuple(lines)

    def _cause(self) -> str:
        offset, asked = self.offset, self._unit.time_offset_s
        if found := self._travel():
            return found
        if asked is not None and offset.significant:
            return f"it is {offset}: imu.time_offset: {asked - offset.late_s:.3f} or auto?"
        if self._left_handed():
            return "its axes are left-handed: two of imu.axes swapped, or a sign wrong?"
        return self._bias() if len(self._offsets.fits) >= _FITS else ""

    def _travel(self) -> str:
        fits = self._offsets.fits
        return travel_finding([fit.forward_b for fit in fits], self._unit.mounting_yaw_rad)

    def _bias(self) -> str:
        found = ""
        if self._estimate is not None and self._navigated_s > 0.0:
            ins = self._estimate.ins
            found = bias_finding(
                ins.gyro_bias_radps, ins.accel_bias_mps2, self._unit.grade, self._navigated_s
            )
        return found or self._began or ""

    def _left_handed(self) -> bool:
        """Whether the sensors go with the fixes once the gyros turn the other way."""
        if self._block is None:
            return False
        mirrored = replace(self._block, dtheta_b_rad=-self._block.dtheta_b_rad)
        fits = [self._fitted(mirrored, fixes) for fixes in self._offsets.unexplained]
        return len(fits) > 0 and sum(fits) > 0.5 * len(fits)

    def _fitted(self, block: ImuBlock, fixes: Sequence[GnssFix]) -> bool:
        unit, loop = self._unit, self._offsets.loop
        return not isinstance(fit_stretch(block, fixes, unit.grade, unit.lever_b_m, loop), str)
