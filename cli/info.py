"""`deepgnss info`: what a recording holds, and what may be wrong with it or its description."""

from __future__ import annotations

import math
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table
from rich.text import Text

from deepgnss.core.errors import RecordingError
from deepgnss.core.records import SampleBlock, StreamInfo
from deepgnss.evaluate.inspection import Inspection, inspect
from deepgnss.evaluate.inspection_figures import draw_inspection, histogram_text, spectrum_text
from deepgnss.evaluate.satellites import Survey, signals_within, survey
from deepgnss.io.config import load_config
from deepgnss.io.formats import StreamFormat
from deepgnss.io.metadata import open_recording
from deepgnss.io.recording import Recording
from deepgnss.io.samples import full_scale
from deepgnss.receiver.continuity import SampleSlip, find_sample_slips

_MOST_SAMPLES = 20_000_000  # looked at, whatever --seconds says: memory stays bounded
_COARSE = 15  # quantizers of up to 4 bits are at full scale most of the time


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("--config", "config_file", type=click.Path(path_type=Path), help="car.yaml")
@click.option(
    "--set", "settings", multiple=True, metavar="KEY=VALUE", help="Change a key (repeatable)."
)
@click.option(
    "--plot", type=click.Path(path_type=Path, dir_okay=False), help="Histogram and spectrum as PNG."
)
@click.option(
    "--seconds",
    type=click.FloatRange(0.0, min_open=True),
    default=0.1,
    show_default=True,
    help="Length of recording looked at.",
)
@click.option(
    "--skip",
    type=click.FloatRange(0.0),
    default=0.0,
    show_default=True,
    help="Seconds to leave out at the start.",
)
@click.option("--satellites/--no-satellites", default=True, help="Look for satellites.")
def info(
    recording: Path,
    config_file: Path | None,
    settings: tuple[str, ...],
    plot: Path | None,
    seconds: float,
    skip: float,
    satellites: bool,
) -> None:
    """Look at a RECORDING: levels, spectrum, satellites, and what may be wrong with it."""
    console = Console(highlight=False)
    config = load_config(config_file, settings)
    streams = tuple(stream.stream_format() for stream in config.recording.streams)
    opened, description = open_recording(recording, streams)
    with opened:
        for note in (*description.notes, *opened.notes):
            console.print(f"note: {note}", style="yellow", markup=False, soft_wrap=True)
        start = description.start or config.recording.start_time
        if start is not None:
            console.print(f"start      {start:%Y-%m-%d %H:%M:%S} UTC (as described)")
        seen = []
        for place, (stream, form) in enumerate(
            zip(opened.streams, description.streams, strict=True)
        ):
            first = _first_sample(stream, skip)
            seen.append(_look(opened, place, first, seconds, full_scale(form)))
            _print_stream(console, seen[-1], form)
            surveys = []
            slips: list[str] = []
            if satellites:
                surveys = _surveys(opened, place, first)
                slips = _slips(console, opened, place, surveys)
            _print_findings(console, seen[-1], surveys, slips)
    if plot is not None:
        draw_inspection(plot, seen)
        console.print(f"\nplot       {plot}", soft_wrap=True)


def _first_sample(stream: StreamInfo, skip_s: float) -> int:
    first = round(skip_s * stream.sample_rate_hz)
    if not 0 <= first < stream.sample_count:
        length_s = stream.sample_count / stream.sample_rate_hz
        raise RecordingError(f"--skip {skip_s:g}: stream {stream.name} is {length_s:.6g} s long")
    return first


def _look(recording: Recording, place: int, first: int, seconds: float, top: int) -> Inspection:
    stream = recording.streams[place]
    wanted = max(round(seconds * stream.sample_rate_hz), 1)
    count = min(wanted, stream.sample_count - first, _MOST_SAMPLES)
    return inspect(recording.read(place, first, count), top)


def _surveys(recording: Recording, place: int, first: int) -> list[Survey]:
    def read(start: int, count: int) -> SampleBlock:
        return recording.read(place, start, count)

    return [survey(read, signal, first) for signal in signals_within(recording.streams[place])]


def _slips(console: Console, recording: Recording, place: int, surveys: list[Survey]) -> list[str]:
    """Lines on lost and inserted samples, by the first signal with satellites."""
    stream = recording.streams[place]

    def read(start: int, count: int) -> SampleBlock:
        return recording.read(place, start, count)

    for one in surveys:
        if len(one.found) < 2:
            continue
        seen = find_sample_slips(read, stream, one.signal)
        if not seen.satellites:
            continue
        if not seen.slips:
            console.print(
                f"\ncontinuous: codes of {len(seen.satellites)} satellites run on through the"
                f" whole stream ({seen.probes} probes)"
            )
        return [_slip_text(slip, stream) for slip in seen.slips]
    return []


def _slip_text(slip: SampleSlip, stream: StreamInfo) -> str:
    what = "lost" if slip.lost > 0 else "too many"
    return (
        f"{abs(slip.lost)} samples {what} at sample {slip.sample} ± {slip.uncertainty}"
        f" ({slip.sample / stream.sample_rate_hz * 1e3:.3f} ms), modulo {slip.modulo:.10g}"
    )


def _print_stream(console: Console, seen: Inspection, form: StreamFormat) -> None:
    stream, levels = seen.block.stream, seen.levels
    looked_s = len(seen.block.samples) / stream.sample_rate_hz
    console.print()
    console.rule(Text(f"stream {stream.name}", style="bold"), align="left")
    facts = Table.grid(padding=(0, 2))
    kind = "I/Q" if stream.is_complex else "real"
    facts.add_row("format", f"{form.format} {kind}, {stream.sample_rate_hz / 1e6:.10g} Msps")
    facts.add_row(
        "frequency",
        f"{stream.centre_hz / 1e6:.10g} MHz at {stream.intermediate_hz / 1e6:.10g} MHz",
    )
    facts.add_row(
        "duration",
        f"{stream.sample_count / stream.sample_rate_hz:.6g} s, {stream.sample_count} samples"
        f" ({looked_s:.3g} s looked at, from sample {seen.block.first} on)",
    )
    facts.add_row("level", f"rms {levels.rms:.4g}, {levels.dbfs:.1f} dBFS")
    dc = f"{levels.dc.real:+.4g}" + (f" {levels.dc.imag:+.4g}j" if stream.is_complex else "")
    facts.add_row("offset", f"{dc} ({_percent(abs(levels.dc), levels.rms)} of rms)")
    if stream.is_complex:
        facts.add_row(
            "I against Q",
            f"{levels.gain_imbalance_db:+.2f} dB,"
            f" {math.degrees(levels.quadrature_error_rad):+.2f}° from quadrature",
        )
    if seen.full_scale > _COARSE:
        facts.add_row("full scale", f"{levels.saturated_share:.2%} of values at {seen.full_scale}")
    console.print(facts)
    for title, lines in (
        ("values", histogram_text(seen)),
        ("spectrum, dB", spectrum_text(seen)),
    ):
        console.print(f"\n{title}", style="dim")
        console.print(Text("\n".join(lines)), no_wrap=True, crop=False, overflow="ignore")


def _print_findings(
    console: Console, seen: Inspection, surveys: list[Survey], slips: list[str]
) -> None:
    for one in surveys:
        _print_satellites(console, one)
    findings = [*seen.findings, *(text for one in surveys for text in one.findings), *slips]
    console.print()
    for text in findings:
        console.print(Text(f"? {text}", style="yellow"), soft_wrap=True)
    if not findings:
        console.print("nothing looks wrong", style="green")


def _print_satellites(console: Console, one: Survey) -> None:
    name = one.signal.id.name
    if not one.found:
        console.print(f"\nsatellites {name}: none found")
        return
    table = Table(title=f"satellites {name}", title_justify="left", box=None, padding=(0, 2))
    for column in ("satellite", "C/N0 dB-Hz", "Doppler Hz", "code chips", "peak/noise", "limit"):
        table.add_column(column, justify="left" if column == "satellite" else "right")
    for found in one.found:
        table.add_row(
            found.satellite,
            f"{found.cn0_dbhz:.1f}",
            f"{found.doppler_hz:+.0f}",
            f"{found.code_chips:.2f}",
            f"{found.peak_ratio:.1f}",
            f"{found.threshold:.1f}",
        )
    console.print()
    console.print(table)
    if one.drift is not None:
        console.print(
            f"code drift over Doppler {one.drift.ratio:+.2f} ± {one.drift.sigma:.2f}"
            f" (upright: +1), sample clock {-one.drift.clock_ppm:+.2f} ppm",
            style="dim",
        )


def _percent(part: float, whole: float) -> str:
    return f"{part / whole:.1%}" if whole > 0.0 else "0 %"
