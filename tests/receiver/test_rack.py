"""Channels side by side against each by itself."""

from __future__ import annotations

import numpy as np
import pytest
from sampled_code import CARRIER_HZ, sampled, signal_command, stream

from deepgnss.core.records import NcoCommand, SampleBlock
from deepgnss.receiver.baseband import RunningSumBuffer, correlate, running_sums
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.modes import TrackingSettings
from deepgnss.receiver.rack import code_table, correlate_all, run_together
from deepgnss.receiver.signals import GPS_L1CA_SIGNAL, code_runs

RATE_HZ = 2.61e6
TRUTH = {
    3: signal_command(0, doppler_hz=1200.0, code_chips=17.0),
    31: signal_command(0, doppler_hz=-900.0, code_chips=801.5, carrier_cycles=0.3),
}


def _samples(count: int) -> SampleBlock:
    """Two satellites and noise."""
    info = stream(RATE_HZ)
    noise = 40.0 * np.random.default_rng(3).standard_normal((count, 2))
    for prn, command in TRUTH.items():
        noise += sampled(info, prn, command, 0, count, 4.0).samples
    return SampleBlock(info, 0, np.clip(np.rint(noise), -127, 127).astype(np.int8))


def _channels() -> list[Channel]:
    return [
        Channel(
            GPS_L1CA_SIGNAL,
            prn,
            TrackingSettings(),
            sample_rate_hz=RATE_HZ,
            sample=500,
            code_chips=command.code_chips + 500.0 / RATE_HZ * command.code_hz,
            doppler_hz=command.carrier_hz + 4.0,
        )
        for prn, command in TRUTH.items()
    ]


def test_together_is_bit_by_bit_what_each_does_alone() -> None:
    block = _samples(int(0.5 * RATE_HZ))
    alone, together = _channels(), _channels()
    buffer = RunningSumBuffer(block.stream, CARRIER_HZ, 30_000)
    for first in range(0, block.samples.shape[0], 11_001):
        buffer.keep_from(max(0, first - 5000))
        piece = block.samples[first : first + 11_001]
        buffer.append(SampleBlock(block.stream, first, piece))
        for channel in alone:
            channel.run(buffer.sums)
        run_together(together, buffer.sums, {})
    for one, other in zip(alone, together, strict=True):
        assert len(one.history) > 20
        assert one.history == other.history
        assert one.filled == other.filled > 0


@pytest.mark.kernel
def test_every_channel_has_its_own_code_command_and_periods() -> None:
    sums = running_sums(_samples(30_000), CARRIER_HZ)
    taps = np.array([0.25, 0.0, -0.25])
    table = code_table("GPS_L1CA")
    commands = {
        31: NcoCommand(700, 0.1, -850.0, 3.0, 0.25, 1.0229e6, 0.01),
        3: NcoCommand(61, 0.4, 1250.0, 0.0, -0.5, 1.0231e6, 0.0),
    }
    due = np.array([(table.rows[31], 2, 5), (table.rows[3], 0, 7)])
    out = np.zeros((2, 7, 3), dtype=np.complex128)
    correlate_all(
        sums.packed,
        sums.first,
        sums.step,
        sums.sample_rate_hz,
        np.column_stack([list(commands.values()), due]),
        table.edges,
        table.signs,
        table.runs,
        taps,
        out,
    )
    for row, (prn, command) in enumerate(commands.items()):
        _, skip, periods = due[row]
        wanted = correlate(sums, command, code_runs("GPS_L1CA", prn), taps, periods, skip)
        assert np.array_equal(out[row, :periods], wanted)
    assert not out[0, 5:].any()
