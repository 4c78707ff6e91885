"""Long updates against 1 ms on the same recording at 25 Msps, beside L table 2 (a V100).

CPU time of everything a channel does (correlate, discriminate, filter, detect, decide), one
thread, once all are in phase lock; the samples' shared running sum, search, messages and positions
are not in it.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
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
from deepgnss.receiver.rack import run_together
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
LOCKED_S = 2.0


def spent_us(folder: Path, settings: Sequence[str]) -> float:
    """CPU µs per channel and ms of signal, of channels in phase lock."""
    config = load_config(
        folder / "config.yaml",
        ("start=causal", f"nav={folder / 'nav.rnx'}", "threads=1", "acquisition.weak=false")
        + tuple(settings),
    )
    spent_s = tracked_ms = 0.0

    def timed(
        channels: Sequence[Channel], sums: RunningSums, aiding: Mapping[str, AidingSource]
    ) -> None:
        nonlocal spent_s, tracked_ms
        began = thread_time()
        before = sum(channel.periods + channel.filled for channel in channels)
        run_together(channels, sums, aiding)
        if sums.first / sums.sample_rate_hz > LOCKED_S:
            if not all(channel.mode is Mode.PHASE for channel in channels):
                raise RuntimeError("a channel is not in phase lock")
            spent_s += thread_time() - began
            after = sum(channel.periods + channel.filled for channel in channels)
            tracked_ms += (after - before) * channels[0].signal.period_s * 1e3

    formats = tuple(stream.stream_format() for stream in config.recording.streams)
    opened, description = open_recording(folder / "rec.bin", formats)
    with opened, patch("deepgnss.receiver.receiver.run_together", timed):
        plan = plan_run(config, opened.streams, description.start)
        for _ in Engine(plan, opened, plan.knowledge, None).steps():
            pass
    return spent_s / tracked_ms * 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=6.0, help="length of the recording")
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
