"""Long updates against 1 ms on the same recording at 25 Msps, beside L table 2 (a V100).

CPU time of everything a channel does (correlate, discriminate, filter, detect, decide), one
thread, once all are in phase lock; the samples' shared running sum, search, messages and positions
are not in it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from time import thread_time
from unittest.mock import patch

from tables import markdown

from deepgnss.core.records import RunningSums
from deepgnss.deep.engine import Engine
from deepgnss.deep.setup import plan_run
from deepgnss.evaluate.reproduce.speed import CORRELATED_HZ, correlator_cost
from deepgnss.io.config import load_config
from deepgnss.io.metadata import open_recording
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.modes import AidingSource, Mode
from deepgnss.receiver.rack import Rack
from deepgnss.sim.output import write_simulation
from deepgnss.sim.schema import build, load_scenario

LOOPS = {
    "pll3, 1 ms": (
        "tracking.carrier={loop: pll3, bandwidth: 15, coherent: 0.001}",
        "tracking.code.coherent=0.001",
    ),
    "pll3, 20 ms": ("tracking.carrier={loop: pll3, bandwidth: 7}",),
    "long_update, 200 ms": ("tracking.carrier={loop: long_update, long_update: {update: 0.2}}",),
    "long_update, 400 ms": ("tracking.carrier={loop: long_update, long_update: {update: 0.4}}",),
}
PUBLISHED = {"pll3, 1 ms": "52", "long_update, 200 ms": "1860"}
STREAM = "streams=[{name: L1, format: int8, sample_rate: 25.0e6}]"
SETTLED_S = 8.0  # the code loop has its last bandwidth


class TimedRack(Rack):
    """Channels through an epoch, and what it took."""

    def __init__(
        self, channels: Sequence[Channel], aiding: Mapping[str, AidingSource], end: int
    ) -> None:
        self._channels = channels
        self._before = self._periods
        one = channels[0]
        self.begin_s = one.command.sample / one.nco.rates.sample_hz
        self.spent_s = self.tracked_ms = 0.0
        with self._counting():
            super().__init__(channels, aiding, end)

    def advance(self, sums: RunningSums) -> None:
        with self._counting():
            super().advance(sums)

    def finish(self) -> None:
        with self._counting():
            super().finish()
        if self.begin_s > SETTLED_S and not all(c.mode is Mode.PHASE for c in self._channels):
            raise RuntimeError("a channel is not in phase lock")
        periods = self._periods - self._before
        self.tracked_ms = periods * self._channels[0].signal.period_s * 1e3

    @property
    def _periods(self) -> int:
        return sum(channel.periods + channel.filled for channel in self._channels)

    @contextmanager
    def _counting(self) -> Iterator[None]:
        began = thread_time()
        yield
        self.spent_s += thread_time() - began


def spent_us(folder: Path, settings: Sequence[str]) -> float:
    """CPU µs per channel and ms of signal, of channels in phase lock."""
    config = load_config(
        folder / "config.yaml",
        ("start=causal", f"nav={folder / 'nav.rnx'}", "threads=1", "acquisition.weak=false")
        + tuple(settings),
    )
    racks: list[TimedRack] = []

    def timed(
        channels: Sequence[Channel], aiding: Mapping[str, AidingSource], end: int
    ) -> TimedRack:
        racks.append(TimedRack(channels, aiding, end))
        return racks[-1]

    formats = tuple(stream.stream_format() for stream in config.recording.streams)
    opened, description = open_recording(folder / "rec.bin", formats)
    with opened, patch("deepgnss.receiver.receiver.Rack", timed):
        plan = plan_run(config, opened.streams, description.start)
        for _ in Engine(plan, opened, plan.knowledge, None).steps():
            pass
    settled = [rack for rack in racks if rack.begin_s > SETTLED_S]
    return 1e6 * sum(rack.spent_s for rack in settled) / sum(rack.tracked_ms for rack in settled)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=11.0, help="length of the recording")
    seconds = parser.parse_args().seconds
    correlating_us = correlator_cost(CORRELATED_HZ, True, 5).channel_us
    rows = [["correlator alone", f"{correlating_us:.2f}", f"{1e3 / correlating_us:.0f}", ""]]
    with TemporaryDirectory(prefix="deepgnss-") as name:
        folder = Path(name)
        scenario = load_scenario("bench", (STREAM, f"seconds={seconds:g}", "oscillator=OCXO"))
        write_simulation(build(scenario), folder, 1)
        for loop, settings in LOOPS.items():
            us = spent_us(folder, settings)
            rows.append([loop, f"{us:.2f}", f"{1e3 / us:.0f}", PUBLISHED.get(loop, "")])
    print(markdown(["loop", "µs per channel and ms", "channels per core", "L, V100"], rows))


if __name__ == "__main__":
    main()
