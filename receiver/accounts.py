"""How far each satellite came in a run, and what held it back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from deepgnss.core.records import STAGES, ChannelReport, NavSolution, SatelliteOutcome
from deepgnss.receiver.acquisition import Acquisition
from deepgnss.receiver.signals import Signal


class Accounts:
    """Keeps one `SatelliteOutcome` per satellite of the receiver's signals."""

    def __init__(self, signals: Sequence[Signal]) -> None:
        self._outcomes = {
            signal.satellite(prn): SatelliteOutcome(
                signal.satellite(prn), signal.id.name, STAGES[0], None, None, 0, ""
            )
            for signal in signals
            for prn in signal.prns
        }

    @property
    def outcomes(self) -> tuple[SatelliteOutcome, ...]:
        """All satellites of the signals."""
        return tuple(self._outcomes.values())

    def stage(self, satellite: str) -> str:
        """Furthest stage so far."""
        return self._outcomes[satellite].stage

    def advance(self, satellite: str, stage: str, reason: str = "") -> None:
        """Note a stage; one already passed stays, with the new reason unless it is empty."""
        outcome = self._outcomes[satellite]
        if STAGES.index(stage) > STAGES.index(outcome.stage):
            outcome = replace(outcome, stage=stage, reason=reason)
        elif reason:
            outcome = replace(outcome, reason=reason)
        self._outcomes[satellite] = outcome

    def searched(self, seen: Acquisition) -> None:
        """Note the outcome of a search."""
        outcome = self._outcomes[seen.satellite]
        peak = max(seen.peak_ratio, outcome.acquisition_peak or 0.0)
        self._outcomes[seen.satellite] = replace(outcome, acquisition_peak=peak)
        self.advance(seen.satellite, "acquired" if seen.found else "searched")
        if not seen.found and STAGES.index(outcome.stage) <= STAGES.index("searched"):
            self.advance(seen.satellite, "searched", seen.reason)

    def tracked(self, report: ChannelReport) -> None:
        """Note the strength a channel sees."""
        outcome = self._outcomes[report.satellite]
        if outcome.cn0_dbhz is None or report.cn0_dbhz > outcome.cn0_dbhz:
            self._outcomes[report.satellite] = replace(outcome, cn0_dbhz=report.cn0_dbhz)

    def solved(self, solution: NavSolution) -> None:
        """Note who was in a position, and why others were not."""
        if solution.valid:
            for satellite in solution.used:
                outcome = self._outcomes.get(satellite)
                if outcome is not None:
                    self._outcomes[satellite] = replace(
                        outcome, stage="used", used_epochs=outcome.used_epochs + 1, reason=""
                    )
        for satellite, reason in solution.rejected.items():
            if satellite in self._outcomes and satellite not in solution.used:
                self.advance(satellite, self.stage(satellite), f"rejected: {reason}")
