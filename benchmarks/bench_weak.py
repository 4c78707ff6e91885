"""CPU of one channel in frequency tracking against phase lock, on the same recorded samples.

Run: python benchmarks/bench_weak.py. Correlation is the same for both; the loops' own share is
shown beside.
"""

from __future__ import annotations

from dataclasses import replace
from time import process_time

import numpy as np
from tables import markdown

from deepgnss.core.records import GPS_L1CA, RunningSums, SampleBlock, StreamInfo
from deepgnss.receiver import channel as channel_module
from deepgnss.receiver.baseband import RunningSumBuffer
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.modes import Mode, TrackingSettings
from deepgnss.receiver.signals import GPS_L1CA_SIGNAL, ca_code

RATE_HZ, SECONDS, PRN, DOPPLER_HZ, CN0_DBHZ = 2.6e6, 13.0, 7, 900.0, 34.0
EPOCH_S, SETTLED_S, REPEATS = 0.1, 3.0, 7


def _samples(first: int, count: int) -> np.ndarray:
    """Complex int8 samples (count, 2) of one satellite in noise."""
    t = (first + np.arange(count)) / RATE_HZ
    chips = t * GPS_L1CA.chip_rate_hz * (1.0 + DOPPLER_HZ / GPS_L1CA.carrier_hz)
    bits = np.random.default_rng(3).choice((-1.0, 1.0), int(SECONDS * 50) + 2)
    code = ca_code(PRN)[(chips % 1023).astype(np.int64)] * bits[(chips // (20 * 1023)).astype(int)]
    sigma = 20.0
    amplitude = sigma * np.sqrt(2.0 * 10.0 ** (0.1 * CN0_DBHZ) / RATE_HZ)
    signal = amplitude * code * np.exp(2j * np.pi * DOPPLER_HZ * t)
    noise = np.random.default_rng([5, first]).standard_normal((count, 2)) * sigma
    both = noise + np.column_stack([signal.real, signal.imag])
    return np.asarray(np.clip(np.round(both), -127, 127).astype(np.int8))


def _run(blocks: list[RunningSums], settings: TrackingSettings) -> tuple[float, float, str]:
    """CPU seconds per second of signal, the correlator's share of it, and the last mode."""
    channel = Channel(
        GPS_L1CA_SIGNAL,
        PRN,
        settings,
        sample_rate_hz=RATE_HZ,
        sample=0,
        code_chips=0.0,
        doppler_hz=DOPPLER_HZ + 2.0,
    )
    spent_s = within_s = 0.0
    correlate = channel_module.correlate

    def timed(*args):  # type: ignore[no-untyped-def]
        nonlocal within_s
        began = process_time()
        taken = correlate(*args)
        within_s += process_time() - began
        return taken

    channel_module.correlate = timed
    try:
        for sums in blocks:
            if sums.end < SETTLED_S * RATE_HZ:
                channel.run(sums)
                channel.begin_epoch()
                within_s = 0.0
                continue
            began = process_time()
            channel.begin_epoch()
            channel.run(sums)
            spent_s += process_time() - began
    finally:
        channel_module.correlate = correlate
    seconds = SECONDS - SETTLED_S
    return spent_s / seconds, within_s / seconds, channel.mode.value


def _blocks() -> list[RunningSums]:
    """Running sums of the recording, each from its own piece so that all can be kept."""
    count = int(SECONDS * RATE_HZ)
    stream = StreamInfo("L1", RATE_HZ, GPS_L1CA.carrier_hz, 0.0, True, count)
    buffer = RunningSumBuffer(stream, GPS_L1CA.carrier_hz, int(0.4 * RATE_HZ))
    blocks = []
    for end in range(int(EPOCH_S * RATE_HZ), count + 1, int(EPOCH_S * RATE_HZ)):
        buffer.keep_from(max(0, buffer.end - int(0.04 * RATE_HZ)))
        first = buffer.end
        buffer.append(SampleBlock(stream, first, _samples(first, end - first)))
        blocks.append(_kept(buffer.sums))
    return blocks


def _kept(sums: RunningSums) -> RunningSums:
    return replace(sums, packed=sums.packed.copy())


def main() -> None:
    blocks = _blocks()
    phase = TrackingSettings(phase_threshold_dbhz=28.0)
    weak = TrackingSettings(phase_threshold_dbhz=60.0, frequency_threshold_dbhz=18.0)
    squares = replace(weak, frequency=replace(weak.frequency, discriminator="psfft"))
    rows = []
    for name, settings in (("PLL", phase), ("PSFFT", squares)):
        runs = [_run(blocks, settings) for _ in range(REPEATS)]  # others may share the machine
        spent_s, within_s = (min(run[k] for run in runs) for k in range(2))
        loops_s = min(spent - within for spent, within, _ in runs)
        rows.append(
            [f"{name} (ended in {Mode(runs[-1][2]).name})"]
            + [f"{1e6 * v / 50.0:.0f}" for v in (spent_s, within_s, loops_s)]
        )
    print(markdown(("mode", "µs per symbol", "correlator", "loops"), rows))


if __name__ == "__main__":
    main()
