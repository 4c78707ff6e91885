"""Which channels in open loop are given up, and when."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.deep.straying import Straying, Unheard
from deepgnss.receiver.signals import BDS_B1I_D1, BDS_B1I_D2, GPS_L1CA_SIGNAL
from deepgnss.theory.reach import reach

GPS = Unheard("G05", GPS_L1CA_SIGNAL)
D1 = Unheard("C10", BDS_B1I_D1)
D2 = Unheard("C03", BDS_B1I_D2)
STEP_S = 0.1


def ended(
    one: Unheard, rate_mps: float, until_s: float, straying: Straying | None = None
) -> tuple[float, str]:
    """When a channel whose rate is known to a 1σ is given up, and why; infinite: it is not."""
    straying = straying or Straying(0.25)
    for now_s in np.arange(0.0, until_s, STEP_S):
        gone: Mapping[str, str] = straying.take(float(now_s), [one], np.array([rate_mps]))
        if gone:
            return float(now_s), gone[one.satellite]
    return np.inf, ""


@pytest.mark.parametrize("one", [GPS, D1])
def test_a_steady_rate_ends_it_when_the_code_is_out_of_reach(one: Unheard) -> None:
    chip_m = SPEED_OF_LIGHT_MPS / one.signal.id.chip_rate_hz
    due_s = reach(0.005, 0.25).code_chips * chip_m / 3.0
    at_s, reason = ended(one, 3.0, 60.0)
    assert at_s == pytest.approx(due_s, abs=2.0 * STEP_S)
    assert "code" in reason


def test_a_rate_too_wide_for_the_sums_ends_it_at_once() -> None:
    limit_mps = reach(0.005, 0.25).frequency_hz * SPEED_OF_LIGHT_MPS / GPS.signal.id.carrier_hz
    assert ended(GPS, 1.01 * limit_mps, 1.0)[0] == 0.0
    assert "frequency" in ended(GPS, 1.01 * limit_mps, 1.0)[1]
    assert ended(GPS, 0.99 * limit_mps, 1.0)[0] == np.inf
    assert ended(D2, 1.01 * limit_mps, 1.0)[0] == np.inf  # symbols of 2 ms: sums of 1 ms


def test_a_well_known_rate_goes_on_for_minutes() -> None:
    assert ended(GPS, 0.2, 600.0)[0] == np.inf


def test_a_flash_of_signal_begins_no_new_open_loop_and_a_return_does() -> None:
    whole_s, _ = ended(GPS, 3.0, 100.0)
    straying = Straying(0.25)
    assert ended(GPS, 3.0, 20.0, straying)[0] == np.inf
    for away_s, again in ((1.0, False), (10.0, True)):
        straying = Straying(0.25)
        ended(GPS, 3.0, 20.0, straying)
        now_s, gone = 20.0 + away_s, {}
        while not gone:
            gone = straying.take(now_s, [GPS], np.array([3.0]))
            now_s += STEP_S
        assert now_s == pytest.approx(
            20.0 + away_s + whole_s if again else whole_s, abs=3.0 * STEP_S
        )
