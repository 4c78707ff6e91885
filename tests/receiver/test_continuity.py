"""Lost and inserted samples: places, sizes, signs; none where there are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from captures import CAPTURES, jrc_whole
from noisy_sky import Sent, info, sky

from deepgnss.core.records import SampleBlock, StreamInfo
from deepgnss.receiver.continuity import Continuity, find_sample_slips

SATELLITES = [
    Sent(2, 1500.0, 10.0, 47.0, edge=3),
    Sent(9, -3200.0, 500.0, 45.0, edge=11),
    Sent(21, 100.0, 1000.0, 44.0, edge=18),
    Sent(31, 2750.0, 321.0, 44.0, edge=7),
]


def find(stream: StreamInfo, samples: np.ndarray) -> Continuity:
    whole = StreamInfo(*(stream.name, stream.sample_rate_hz, stream.centre_hz),
                       stream.intermediate_hz, samples.ndim == 2, len(samples))  # fmt: skip
    return find_sample_slips(
        lambda first, count: SampleBlock(whole, first, samples[first : first + count]), whole
    )


@pytest.fixture(scope="module")
def recording() -> tuple[StreamInfo, np.ndarray]:
    stream = info(4.0e6)
    rng = np.random.default_rng(1)
    return stream, np.asarray(sky(stream, SATELLITES, 0.25, rng).samples)


def test_none_where_there_are_none(recording: tuple[StreamInfo, np.ndarray]) -> None:
    seen = find(*recording)
    assert len(seen.satellites) >= 3
    assert seen.slips == ()


@pytest.mark.parametrize(("place", "lost"), [(333_333, 37), (700_001, -412), (9_000, 1500)])
def test_place_size_and_sign(
    recording: tuple[StreamInfo, np.ndarray], place: int, lost: int
) -> None:
    stream, samples = recording
    rest = (
        samples[place + lost :] if lost > 0 else np.concatenate([samples[:-lost], samples[place:]])
    )
    (slip,) = find(stream, np.concatenate([samples[:place], rest])).slips
    assert slip.lost == lost
    assert abs(slip.sample - place) <= 2 * slip.uncertainty
    assert slip.uncertainty < 1000
    assert slip.modulo == pytest.approx(4000.0)


def test_size_is_known_modulo_a_period(recording: tuple[StreamInfo, np.ndarray]) -> None:
    stream, samples = recording
    gap = np.concatenate([samples[:400_000], samples[400_000 + 4000 + 5 :]])
    (slip,) = find(stream, gap).slips
    assert slip.lost == 5


def test_nothing_to_judge_by() -> None:
    rng = np.random.default_rng(3)
    noise = np.asarray(sky(info(4.0e6), [], 0.05, rng).samples)
    assert find(info(4.0e6), noise) == Continuity((), 0, ())
    assert find(info(4.0e6), noise[:100]).satellites == ()


def test_captures_of_others(shared_data: Path) -> None:
    """What their makers lost, at multiples of 2²⁰ samples; and a file without."""
    whole = CAPTURES["PocketSDR 4 MHz"]
    assert find(*whole.stream(shared_data)).slips == ()
    (one,) = find(*CAPTURES["PocketSDR 12 MHz"].stream(shared_data)).slips
    assert 85e-3 < one.sample / 12e6 < 90e-3
    assert one.lost / 12e6 * 1.023e6 == pytest.approx(82.0, abs=0.6)
    first, second = find(*CAPTURES["PocketSDR 24 MHz"].stream(shared_data)).slips
    assert first.sample / 24e6 == pytest.approx(43.8e-3, abs=1e-3)
    assert second.sample / 24e6 == pytest.approx(87.5e-3, abs=1e-3)
    path = shared_data / "real" / "if" / CAPTURES["Hanoi"].path
    slips = find(info(5e6, True, -48_750.0), jrc_whole(path)).slips
    milliseconds = [slip.sample / 5e6 * 1e3 for slip in slips]
    assert milliseconds[0] == pytest.approx(2.2, abs=0.5)
    assert milliseconds[-1] == pytest.approx(22.0, abs=0.6)
    assert len(slips) <= 3
