"""SP-CORR, SP-CH, SP-E2E, SP-MEM: what the receiver costs, as a user would run it.

CPU seconds are those of the process alone; × real time is by the clock on the wall, so that it
means something on a machine that does nothing else.
"""

from __future__ import annotations

import os
import resource
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import thread_time
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.records import (
    GPS_L1CA,
    FloatArray,
    NcoCommand,
    PackedSamples,
    RunningSums,
    SampleBlock,
    StreamInfo,
)
from deepgnss.deep.engine import Engine
from deepgnss.deep.outputs import FILES, Outputs
from deepgnss.deep.setup import plan_run
from deepgnss.evaluate.child import DEEPGNSS, Ran, run
from deepgnss.evaluate.reproduce.table import Figure
from deepgnss.evaluate.reproduce.whole_receiver import Recording, recorded
from deepgnss.io.config import load_config
from deepgnss.io.folder import prepare_folder
from deepgnss.io.metadata import open_recording
from deepgnss.receiver.baseband import correlate
from deepgnss.receiver.feed import SumFeed
from deepgnss.receiver.signals import GPS_L1CA_SIGNAL, code_runs
from deepgnss.sim.converter import convert
from deepgnss.sim.generator import input_sigma, sample_source
from deepgnss.sim.output import write_simulation
from deepgnss.sim.scenario import Scenario
from deepgnss.sim.schema import build, load_scenario

# --- SP-CORR -------------------------------------------------------------------------------------

CORRELATED_HZ: Final = 25e6
CHANNELS_PER_CORE: Final = 150
_STRETCH_S: Final = 0.1
_CHANNELS: Final = 8
_TAPS: Final[FloatArray] = np.array([0.125, 0.0, -0.125])


class CorrelatorCost(NamedTuple):
    """CPU time of the baseband core."""

    sum_ns: float  # of the running sum, per sample
    channel_us: float  # per channel and ms of signal


def correlator_cost(
    rate_hz: float, is_complex: bool, runs: int, packed: bool = False
) -> CorrelatorCost:
    """Median cost of a stretch of noise, block by block as the receiver goes through it.

    packed: complex samples of two bits, two in a byte.
    """
    count = round(_STRETCH_S * rate_hz)
    intermediate_hz = 0.0 if is_complex else rate_hz / 4.1
    stream = StreamInfo("L1", rate_hz, GPS_L1CA.carrier_hz, intermediate_hz, is_complex, count)
    shape = (count, 2) if is_complex else (count,)
    generator = np.random.default_rng(1)
    samples = generator.integers(-60, 60, shape, dtype=np.int8)
    table = generator.integers(-3, 4, (256, 2, 2), dtype=np.int8)
    data = generator.integers(0, 256, count // 2 + 1, dtype=np.uint8)

    def read(first: int, length: int) -> SampleBlock:
        if packed:
            held = PackedSamples(
                data[first // 2 : (first + length + 1) // 2], table, first % 2, length
            )
            return SampleBlock(stream, first, held)
        return SampleBlock(stream, first, samples[first : first + length])

    costs = [_pass(SumFeed(read, stream, GPS_L1CA.carrier_hz, 0), count) for _ in range(runs + 1)]
    timed = costs[1:]  # the first one compiles
    return CorrelatorCost(median(c.sum_ns for c in timed), median(c.channel_us for c in timed))


def _pass(feed: SumFeed, count: int) -> CorrelatorCost:
    began, correlating_s, correlated = thread_time(), 0.0, 0
    for sums in feed.advance(count):
        before = thread_time()
        correlated += sum(_correlated(sums, prn) for prn in GPS_L1CA_SIGNAL.prns[:_CHANNELS])
        correlating_s += thread_time() - before
    summing_s = thread_time() - began - correlating_s
    return CorrelatorCost(summing_s / count * 1e9, correlating_s / correlated * 1e6)


def _correlated(sums: RunningSums, prn: int) -> int:
    """Correlate all whole code periods of a block in one channel; their number."""
    signal = GPS_L1CA_SIGNAL
    period = sums.sample_rate_hz * signal.period_s
    start = sums.first + 100 + round(period * prn / 40.0)
    periods = int((sums.first + sums.packed.size * sums.step - start - 100) / period)
    command = NcoCommand(start, 0.3, 500.0 * prn, 0.1, 0.4, 1.023e6 + prn / 3.0, 0.0)
    if periods > 0:
        correlate(sums, command, code_runs(signal.id.name, prn), _TAPS, periods)
    return max(periods, 0)


def measure_correlator(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """SP-CORR."""
    cost = correlator_cost(CORRELATED_HZ, True, 5 if quick else 15)
    channels = 1e3 / cost.channel_us
    return [
        Figure(
            "channels per core",
            f"{channels:.0f} ({cost.channel_us:.2f} µs per channel and ms)",
            channels >= CHANNELS_PER_CORE,
        ),
        Figure("running sum, for all", f"{cost.sum_ns:.2f} ns per sample", None),
    ]


# --- SP-CH, SP-E2E: the program in a process of its own ------------------------------------------

CHANNEL_S: Final = 0.012
TIMES_REAL: Final = 5.0


def _processed(recording: Path, config: Path, seconds: float, *settings: str) -> Ran:
    """`deepgnss process`, all outputs, started at once with the NAV file."""
    folder = config.parent
    given = ("start=causal", f"nav={folder / 'nav.rnx'}", f"recording.duration={seconds}")
    chosen = [part for setting in (*given, *settings) for part in ("--set", setting)]
    where = [str(recording), "--config", str(config)]
    return run([*DEEPGNSS, "process", *where, *chosen, "-o", str(folder / "out")])


def measure_channel(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """SP-CH: what a longer run costs more, so that start and search do not count."""
    short_s, long_s, runs = (10.0, 20.0, 1) if quick else (10.0, 30.0, 3)
    with TemporaryDirectory(prefix="deepgnss-") as folder:
        place = Path(folder)
        run([*DEEPGNSS, "simulate", "bench", "--seconds", str(long_s), "-o", str(place)])

        def spent(seconds: float) -> float:
            files = place / "rec.bin", place / "config.yaml"
            return _processed(*files, seconds, "output.interval=1.0", "threads=1").cpu_s

        spent(short_s)  # compiles the kernels
        short, long = ([spent(seconds) for _ in range(runs)] for seconds in (short_s, long_s))
    satellites = len(build(load_scenario("bench")).scenario.emitters)
    slope_s = (median(long) - median(short)) / (satellites * (long_s - short_s))
    return [
        Figure(
            "CPU per channel and second",
            f"{slope_s:.4f} s ({satellites} satellites, {short_s:g} and {long_s:g} s)",
            0.0 < slope_s <= CHANNEL_S,
        )
    ]


def measure_everything(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """SP-E2E: two wide streams, 24 satellites, aided, all outputs, two threads; quick: 11 s."""
    short_s = 7.0 if quick else 12.0
    with recorded("everything", seeds[0], *(("seconds=11",) if quick else ())) as recording:
        length_s = recording.scenario.seconds
        position = f"position={list(recording.place)}"

        def spent(seconds: float) -> Ran:
            files = recording.written.recording, recording.written.config
            return _processed(*files, seconds, position, "threads=2")

        spent(short_s)  # compiles the kernels
        short, whole = spent(short_s), spent(length_s)
        observed = _observed(recording)
    times = length_s / whole.wall_s
    slope_s = (whole.cpu_s - short.cpu_s) / (length_s - short_s)
    load = os.getloadavg()[0]
    return [
        Figure(
            "real time",
            f"{times:.1f} × ({length_s:g} s in {whole.wall_s:.1f} s; load {load:.1f})",
            None if quick else times >= TIMES_REAL,  # a start of seconds would count most
        ),
        Figure("CPU in all", f"{whole.cpu_s:.1f} s", None),
        Figure(
            "CPU per second of signal",
            f"{slope_s:.3f} s from {short_s:g} s on; on two cores {2.0 / slope_s:.1f} × at best",
            2.0 / slope_s >= TIMES_REAL,
        ),
        Figure("satellites observed", f"{observed} of {len(recording.scenario.emitters)}", None),
        Figure("peak memory", f"{whole.resident_mb:.0f} MB", None),
    ]


def _observed(recording: Recording) -> int:
    """Satellites in the table of observations."""
    lines = (recording.folder / "out" / "observations.csv").read_text().splitlines()
    column = lines[0].split(",").index("satellite")
    return len({line.split(",")[column] for line in lines[1:]})


# --- SP-MEM --------------------------------------------------------------------------------------

LARGEST_MB: Final = 1000.0
FLAT_MB: Final = 20.0  # of growth in an hour, files' buffers and the allocator's included
_EVERY_S: Final = 10.0
_SATELLITES: Final = 4


class _Simulated:
    """A recording that is made while it is read: an hour of it has no file."""

    def __init__(self, scenario: Scenario, stream: StreamInfo) -> None:
        front_end = scenario.streams[0].front_end
        self._samples = sample_source(scenario)
        self._sigma = input_sigma(scenario, front_end)
        self._front_end = front_end
        self._stream = stream

    def read(self, stream: str, first: int, count: int) -> SampleBlock:
        """Samples [first, first + count)."""
        data = convert(self._samples(first, count), self._sigma, self._front_end)
        return SampleBlock(self._stream, first, np.frombuffer(data, np.int8).reshape(-1, 2))


def resident_mb() -> float:
    """Memory of this process: now on Linux, elsewhere the most it ever was."""
    now = Path("/proc/self/statm")
    if now.exists():
        return int(now.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    unit = 1 if sys.platform == "darwin" else 2**10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def residents_mb(seconds: float) -> list[float]:
    """Memory every ten seconds of signal while the receiver runs through them, all outputs open."""
    few = f"satellites.limit={_SATELLITES}"
    beginning = build(load_scenario("bench", ("seconds=1", few)))
    scenario = build(load_scenario("bench", (f"seconds={seconds:g}", few))).scenario
    seen: list[float] = []
    with TemporaryDirectory(prefix="deepgnss-") as folder:
        written = write_simulation(beginning, Path(folder), 1)
        out = Path(folder) / "out"
        given = ("start=causal", f"nav={Path(folder) / 'nav.rnx'}", "threads=1")
        config = load_config(written.config, (*given, f"output.directory={out}"))
        formats = tuple(stream.stream_format() for stream in config.recording.streams)
        opened, description = open_recording(written.recording, formats)
        with opened:
            rate_hz = opened.streams[0].sample_rate_hz
            stream = replace(opened.streams[0], sample_count=round(seconds * rate_hz))
        plan = plan_run(config, (stream,), description.start)
        prepare_folder(out, FILES)
        engine = Engine(plan, _Simulated(scenario, stream), plan.knowledge, None)
        with Outputs(config, plan, plan.knowledge) as outputs:
            for result in engine.steps():
                outputs.write(result, engine.navigated)
                if result.end >= (len(seen) + 1) * _EVERY_S * rate_hz:
                    seen.append(resident_mb())
            outputs.finish(engine.receiver.nav, engine.receiver.accounts.outcomes, {})
    return seen


def measure_memory(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """SP-MEM: in a process of its own, which holds nothing else; quick: 50 s.

    Counted from when everything has happened that happens once.
    """
    seconds, settled_s = (50.0, 30.0) if quick else (3600.0, 60.0)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        seen = pool.submit(residents_mb, seconds).result()
    late = np.array(seen[int(settled_s / _EVERY_S) - 1 :])
    grown_mb = float(late[-1] - late[0])
    span_s = _EVERY_S * (late.size - 1)
    return [
        Figure("largest", f"{max(seen):.0f} MB in {seconds:g} s", max(seen) <= LARGEST_MB),
        Figure(
            "growth",
            f"{grown_mb:+.1f} MB from {settled_s:g} s on, in {span_s:g} s",
            grown_mb <= FLAT_MB,
        ),
    ]
