"""The why-no-fix table's bookkeeping."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from deepgnss.core.records import STAGES, ChannelReport, NavSolution
from deepgnss.core.time import GpsTime
from deepgnss.receiver.accounts import Accounts
from deepgnss.receiver.acquisition import Acquisition
from deepgnss.receiver.signals import GPS_L1CA_SIGNAL

NOISE = Acquisition("G05", 5, 0, 0.0, 0.0, 6.0, 8.0, 20.0, False, "peak 6.00 × noise, 8.00 needed")
PEAK = replace(NOISE, peak_ratio=40.0, found=True, reason="")


def _solution(
    *used: str, rejected: dict[str, str] | None = None, valid: bool = True
) -> NavSolution:
    nothing = np.zeros(3)
    return NavSolution(
        GpsTime(2200, 0.0), valid, "", nothing, nothing, 0.0, 0.0, {}, np.eye(4), np.eye(4), {},
        used, rejected or {}, {}, {},
    )  # fmt: skip


def _report(cn0_dbhz: float) -> ChannelReport:
    return ChannelReport(
        "G05", "GPS_L1CA", "used", "PLL", cn0_dbhz, 0.0, 1.0, 0.0, 1.0, 0.02, 7.0, 1.0
    )


@pytest.fixture
def accounts() -> Accounts:
    return Accounts([GPS_L1CA_SIGNAL])


def _of(accounts: Accounts, satellite: str = "G05") -> tuple[str, str]:
    outcome = next(o for o in accounts.outcomes if o.satellite == satellite)
    return outcome.stage, outcome.reason


def test_all_satellites_begin_unsearched(accounts: Accounts) -> None:
    assert [o.satellite for o in accounts.outcomes] == [f"G{prn:02d}" for prn in range(1, 33)]
    assert {o.stage for o in accounts.outcomes} == {"not searched"}
    assert all(o.acquisition_peak is None and o.cn0_dbhz is None for o in accounts.outcomes)


def test_a_search_leaves_its_best_peak_and_its_reason(accounts: Accounts) -> None:
    accounts.searched(NOISE)
    accounts.searched(replace(NOISE, peak_ratio=5.0, reason="peak 5.00"))
    assert _of(accounts) == ("searched", "peak 5.00")
    assert accounts.outcomes[4].acquisition_peak == 6.0
    accounts.searched(PEAK)
    assert _of(accounts) == ("acquired", "")
    assert accounts.outcomes[4].acquisition_peak == 40.0


def test_stages_only_rise(accounts: Accounts) -> None:
    accounts.searched(PEAK)
    for stage in STAGES[3:]:
        accounts.advance("G05", stage)
        assert accounts.stage("G05") == stage
    accounts.advance("G05", "bit sync")
    assert accounts.stage("G05") == "used"
    accounts.advance("G05", "used", "lost: no signal for 3.0 s")
    accounts.searched(NOISE)  # the search after it was lost does not undo what it reached
    assert _of(accounts) == ("used", "lost: no signal for 3.0 s")


def test_solutions_count_and_say_why_not(accounts: Accounts) -> None:
    accounts.searched(PEAK)
    accounts.advance("G05", "ephemeris")
    accounts.solved(_solution(rejected={"G05": "elevation 3.0° below 10.0°"}))
    assert _of(accounts) == ("ephemeris", "rejected: elevation 3.0° below 10.0°")
    for _ in range(3):
        accounts.solved(_solution("G05", "G07", "C03"))
    accounts.solved(_solution("G05", valid=False))
    assert _of(accounts) == ("used", "")
    assert accounts.outcomes[4].used_epochs == 3


def test_highest_cn0_is_kept(accounts: Accounts) -> None:
    for cn0_dbhz in (38.0, 44.5, 41.0):
        accounts.tracked(_report(cn0_dbhz))
    assert accounts.outcomes[4].cn0_dbhz == 44.5
