"""How far each satellite came in a run, and what held it back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass

from deepgnss.core.records import STAGES, ChannelReport, NavSolution, SatelliteOutcome
from deepgnss.receiver.acquisition import Acquisition
from deepgnss.receiver.signals import Signal

_REACHED = {stage: k for k, stage in enumerate(STAGES)}


@dataclass(slots=True)
class _Account:
    """A `SatelliteOutcome` in the making."""

    satellite: str
    signal: str
    stage: str = STAGES[0]
    acquisition_peak: float | None = None
    cn0_dbhz: float | None = None
    used_epochs: int = 0
    reason: str = ""


class Accounts:
    """Keeps an account of each satellite of the receiver's signals."""

    def __init__(self, signals: Sequence[Signal]) -> None:
        self._accounts = {
            signal.satellite(prn): _Account(signal.satellite(prn), signal.id.name)
            for signal in signals
            for prn in signal.prns
        }

    @property
    def outcomes(self) -> tuple[SatelliteOutcome, ...]:
        """All satellites of the signals."""
        return tuple(SatelliteOutcome(*astuple(one)) for one in self._accounts.values())

    def stage(self, satellite: str) -> str:
        """Furthest stage so far."""
        return self._accounts[satellite].stage

    def advance(self, satellite: str, stage: str, reason: str = "") -> None:
        """Note a stage; one already passed stays, with the new reason unless it is empty."""
        account = self._accounts[satellite]
        if _REACHED[stage] > _REACHED[account.stage]:
            account.stage, account.reason = stage, reason
        elif reason:
            account.reason = reason

    def searched(self, seen: Acquisition) -> None:
        """Note the outcome of a search."""
        account = self._accounts[seen.satellite]
        before = account.stage
        account.acquisition_peak = max(seen.peak_ratio, account.acquisition_peak or 0.0)
        self.advance(seen.satellite, "acquired" if seen.found else "searched")
        if not seen.found and _REACHED[before] <= _REACHED["searched"]:
            self.advance(seen.satellite, "searched", seen.reason)

    def tracked(self, report: ChannelReport) -> None:
        """Note the strength a channel sees."""
        account = self._accounts[report.satellite]
        if account.cn0_dbhz is None or report.cn0_dbhz > account.cn0_dbhz:
            account.cn0_dbhz = report.cn0_dbhz

    def solved(self, solution: NavSolution) -> None:
        """Note who was in a position, and why others were not."""
        if solution.valid:
            for satellite in solution.used:
                account = self._accounts.get(satellite)
                if account is not None:
                    account.stage, account.reason = "used", ""
                    account.used_epochs += 1
        for satellite, reason in solution.rejected.items():
            if satellite in self._accounts and satellite not in solution.used:
                self.advance(satellite, self.stage(satellite), f"rejected: {reason}")
