"""Every real capture: the satellites others found are found, and none that is not there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from captures import CAPTURES, Capture

from deepgnss.core.records import RunningSums, SampleBlock
from deepgnss.receiver.acquisition import (
    Acquisition,
    AcquisitionSettings,
    SearchWindow,
    cold_search,
    search,
)
from deepgnss.receiver.baseband import running_sums
from deepgnss.receiver.signals import GPS_L1CA_SIGNAL as L1CA

_CARRIER_HZ = L1CA.id.carrier_hz


def first_sums(block: SampleBlock, settings: AcquisitionSettings) -> RunningSums:
    count = round(settings.coherent_s * settings.noncoherent * block.stream.sample_rate_hz) + 64
    return running_sums(replace(block, held=block.samples[:count]), _CARRIER_HZ)


def stays(block: SampleBlock, one: Acquisition, settings: AcquisitionSettings) -> bool:
    """Whether a satellite is there again, in up to twice the time, near where it was."""
    available_s = len(block.samples) / block.stream.sample_rate_hz
    longer = replace(
        settings,
        noncoherent=min(int(available_s / settings.coherent_s), 2 * settings.noncoherent),
        false_alarm=1e-4,
    )
    window = SearchWindow(one.doppler_hz, 100.0, one.code_chips, 2.0)
    return search(first_sums(block, longer), 0, L1CA, one.prn, longer, window).found


@pytest.mark.parametrize("name", CAPTURES)
def test_listed_satellites_are_found_and_no_false_ones(shared_data: Path, name: str) -> None:
    capture: Capture = CAPTURES[name]
    block = capture.block(shared_data)
    results = cold_search(first_sums(block, capture.settings), 0, L1CA, capture.settings)
    found = {one.prn: one for one in results if one.found}
    assert set(capture.listed) <= set(found)
    # Others than those listed are weak satellites that stay: all are checked to be there.
    for prn in set(found) - set(capture.listed):
        assert found[prn].cn0_dbhz < 39.0
        assert stays(block, found[prn], capture.settings), f"G{prn:02d} came from nowhere"


def test_two_chains_of_one_antenna_agree(shared_data: Path) -> None:
    """Zero baseline: code phases equal but for a common delay, Dopplers equal."""
    pair = []
    for name in ("IFEN chain 0", "IFEN chain 1"):
        capture = CAPTURES[name]
        sums = first_sums(capture.block(shared_data), capture.settings)
        results = cold_search(sums, 0, L1CA, capture.settings, capture.listed)
        pair.append({one.prn: one for one in results})
    differences = [pair[1][prn].code_chips - pair[0][prn].code_chips for prn in pair[0]]
    assert max(differences) - min(differences) < 0.1
    assert max(abs(differences[0]), abs(differences[-1])) < 0.15
    for prn, one in pair[0].items():
        assert pair[1][prn].doppler_hz == pytest.approx(one.doppler_hz, abs=3.0)
