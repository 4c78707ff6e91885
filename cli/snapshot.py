"""`deepgnss snapshot`: positions from milliseconds of recording and a NAV file."""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from deepgnss.cli.main import EXIT_NOTHING_USABLE
from deepgnss.core.errors import ConfigError, InputFileError, RecordingError
from deepgnss.core.frames import C_ne, ecef, geodetic
from deepgnss.core.records import GPS_L1CA, NavData, SampleBlock, StreamInfo
from deepgnss.core.time import GpsTime, from_utc
from deepgnss.io.config import Config, load_config
from deepgnss.io.metadata import open_recording
from deepgnss.io.recording import Recording
from deepgnss.io.rinex_nav import read_nav
from deepgnss.io.snappergps import read_snapshots
from deepgnss.io.tables import SatelliteTable, SolutionTable
from deepgnss.io.tracks import GeoJsonTrack
from deepgnss.receiver.coarse_time import Rough
from deepgnss.receiver.signals import GPS_L1CA_SIGNAL
from deepgnss.receiver.snapshot import Snapshot, SnapshotSettings, locate, locate_series
from deepgnss.receiver.weights import PvtParameters

_LONGEST_S = 0.2  # of a recording; more is a case for `process`
_KNOWN_PLACE_M = 50e3  # how rough a `position` of the config may be
_TIME_SIGMA_S = 60.0  # of a start time by hand or by a logger's clock
_VELOCITY_SIGMA_MPS = 300.0


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("--config", "config_file", type=click.Path(path_type=Path), help="YAML file.")
@click.option("--nav", type=click.Path(path_type=Path), help="Broadcast RINEX NAV file.")
@click.option(
    "--time", "start", type=click.DateTime(["%Y-%m-%dT%H:%M:%S"]), help="Start, UTC, ± a minute."
)
@click.option(
    "--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Change a key (repeatable)."
)
@click.option(
    "--velocity",
    "velocity_mps",
    type=click.FloatRange(0.0, min_open=True),
    default=_VELOCITY_SIGMA_MPS,
    show_default=True,
    help="How fast the antenna may move, 1σ, m/s.",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Folder for CSV and GeoJSON.")
def snapshot(
    recording: Path,
    config_file: Path | None,
    nav: Path | None,
    start: datetime | None,
    overrides: tuple[str, ...],
    velocity_mps: float,
    output: Path | None,
) -> None:
    """Coarse-time position and velocity of a RECORDING of milliseconds, GPS L1 C/A.

    RECORDING: samples as the config describes them, or a SnapperGPS file (.json) of many
    snapshots, each of which gives a fix by itself.
    """
    config = load_config(config_file, overrides)
    nav_file = nav or config.nav
    if nav_file is None:
        raise ConfigError(
            "nav: a snapshot needs a broadcast NAV file (--nav, or nav: in the config)"
        )
    data = read_nav(nav_file)
    settings = _settings(config)
    console = Console(highlight=False)
    if recording.suffix == ".json":
        stamped = ((from_utc(one.time), one.block) for one in read_snapshots(recording))
        first = next(stamped)
        _check_day(data, nav_file, first[0])
        rough = _rough(config, first[0], velocity_mps)
        results = locate_series(_chain(first, stamped), GPS_L1CA_SIGNAL, data, rough, settings)
        fixes = _print_series(console, results)
    else:
        block, time = _read_block(recording, config, start)
        _check_day(data, nav_file, time)
        rough = _rough(config, time, velocity_mps)
        fixes = [locate(block, GPS_L1CA_SIGNAL, data, rough, settings)]
        _print_one(console, fixes[0])
    if output is not None:
        _write(output, recording.stem, fixes)
        console.print(f"written    {output}", soft_wrap=True)
    if not any(one.fix.solution.valid for one in fixes):
        raise click.exceptions.Exit(EXIT_NOTHING_USABLE)


# --- what there is to work on --------------------------------------------------------------------


def _chain(
    first: tuple[GpsTime, SampleBlock], rest: Iterator[tuple[GpsTime, SampleBlock]]
) -> Iterator[tuple[GpsTime, SampleBlock]]:
    yield first
    yield from rest


def _settings(config: Config) -> SnapshotSettings:
    positioning = config.positioning
    return SnapshotSettings(
        doppler_max_hz=config.acquisition.doppler_max,
        false_alarm=config.acquisition.false_alarm,
        pvt=PvtParameters(
            elevation_mask_rad=math.radians(positioning.elevation_mask),
            ionosphere=positioning.ionosphere,
            troposphere=positioning.troposphere,
        ),
    )


def _read_block(
    recording: Path, config: Config, start: datetime | None
) -> tuple[SampleBlock, GpsTime]:
    """The samples, and the rough time of the first."""
    streams = tuple(stream.stream_format() for stream in config.recording.streams)
    opened, description = open_recording(recording, streams)
    with opened:
        stream = _stream(opened)
        began = start or config.recording.start_time or description.start
        if began is None:
            raise ConfigError(
                "recording.start_time: a snapshot needs its time to a minute (or --time)"
            )
        first = round(config.recording.skip * stream.sample_rate_hz)
        seconds = min(config.recording.duration or _LONGEST_S, _LONGEST_S)
        count = min(round(seconds * stream.sample_rate_hz), stream.sample_count - first)
        if count < stream.sample_rate_hz * GPS_L1CA_SIGNAL.period_s:
            raise RecordingError(f"{recording}: less than a millisecond of samples")
        time = from_utc(began).plus(config.recording.skip)
        return opened.read(stream.name, first, count), time


def _stream(recording: Recording) -> StreamInfo:
    for stream in recording.streams:
        offset_hz = stream.intermediate_hz + GPS_L1CA.carrier_hz - stream.centre_hz
        if abs(offset_hz) <= stream.sample_rate_hz / 2.0:
            return stream
    raise ConfigError("recording.streams: no stream covers GPS L1 (1575.42 MHz)")


def _rough(config: Config, time: GpsTime, velocity_mps: float) -> Rough:
    if config.position is None:
        return Rough(time, _TIME_SIGMA_S, velocity_sigma_mps=velocity_mps)
    lat_deg, lon_deg, height_m = config.position
    return Rough(
        time,
        _TIME_SIGMA_S,
        r_e_m=ecef(math.radians(lat_deg), math.radians(lon_deg), height_m),
        position_sigma_m=_KNOWN_PLACE_M,
        height_m=height_m,
        velocity_sigma_mps=velocity_mps,
    )


def _check_day(nav: NavData, file: Path, time: GpsTime) -> None:
    """Refuse a NAV file of another day."""
    ages_s = [abs(time.since(one.toe)) for all_of in nav.ephemerides.values() for one in all_of]
    if not ages_s or min(ages_s) > 6 * 3600.0:
        when = f"nearest {min(ages_s) / 3600.0:.0f} h away" if ages_s else "none in it"
        raise InputFileError(f"{file}: no ephemeris for {time.utc():%Y-%m-%d %H:%M} UTC ({when})")


# --- what came out -------------------------------------------------------------------------------


def _print_one(console: Console, result: Snapshot) -> None:
    solution = result.fix.solution
    table = Table(box=None, padding=(0, 2))
    for name in ("satellite", "C/N0 dB-Hz", "Doppler Hz", "elevation °", "residual m", "use"):
        table.add_column(name, justify="left" if name in ("satellite", "use") else "right")
    for one in result.measured:
        direction = solution.azimuth_elevation_rad.get(one.satellite)
        residual_m = solution.residuals_m.get(one.satellite)
        table.add_row(
            one.satellite,
            f"{one.cn0_dbhz:.1f}",
            f"{one.doppler_hz:+.1f}",
            "" if direction is None else f"{math.degrees(direction[1]):.0f}",
            "" if residual_m is None else f"{residual_m:+.1f}",
            "used" if one.satellite in solution.used else solution.rejected.get(one.satellite, ""),
        )
    console.print(table)
    if not solution.valid:
        console.print(f"no fix: {solution.reason}")
        return
    lat, lon, height_m = geodetic(solution.r_e_m)
    north, east, down = C_ne(lat, lon) @ solution.v_e_mps
    to_n = C_ne(lat, lon)
    sigma_m = np.sqrt(np.diag(to_n @ solution.covariance_m2[:3, :3] @ to_n.T))
    facts = Table.grid(padding=(0, 2))
    facts.add_row("position", f"{math.degrees(lat):.6f}° {math.degrees(lon):.6f}° {height_m:.1f} m")
    facts.add_row("", "ECEF " + " ".join(f"{x:.1f}" for x in solution.r_e_m) + " m")
    facts.add_row("1σ N E D", " ".join(f"{x:.1f}" for x in sigma_m) + " m")
    facts.add_row("velocity", f"N {north:+.2f}  E {east:+.2f}  D {down:+.2f} m/s")
    facts.add_row(
        "time", f"{solution.time.utc():%Y-%m-%d %H:%M:%S.%f} UTC ± {result.fix.time_sigma_s:.4f} s"
    )
    facts.add_row(
        "oscillator",
        f"{solution.drift_sps * 1e6:+.4f} ppm: carriers appear"
        f" {-solution.drift_sps * GPS_L1CA.carrier_hz:+.0f} Hz off",
    )
    facts.add_row("clock", f"{solution.clock_s * 1e6:+.3f} µs modulo 1 ms")
    console.print(facts)


def _print_series(console: Console, results: Iterator[Snapshot]) -> list[Snapshot]:
    console.print(
        "each fix by its own samples; earlier ones give only where to search, the whole"
        " milliseconds and the error of the time stamps",
        style="dim",
    )
    fixes = []
    for result in results:
        fixes.append(result)
        solution = result.fix.solution
        stamp = f"{solution.time.utc():%H:%M:%S.%f}"[:-3]
        if not solution.valid:
            console.print(f"{stamp}  no fix: {solution.reason}", soft_wrap=True)
            continue
        lat, lon, height_m = geodetic(solution.r_e_m)
        console.print(
            f"{stamp}  {math.degrees(lat):.6f} {math.degrees(lon):.6f} {height_m:6.1f} m"
            f"  {len(solution.used)} satellites  hdop {solution.dops.get('hdop', math.nan):.1f}",
            soft_wrap=True,
        )
    valid = sum(one.fix.solution.valid for one in fixes)
    console.print(f"{valid} of {len(fixes)} snapshots fixed")
    return fixes


def _write(folder: Path, name: str, fixes: list[Snapshot]) -> None:
    with (
        SolutionTable(folder / "solution.csv") as solutions,
        SatelliteTable(folder / "satellites.csv") as satellites,
        GeoJsonTrack(folder / "track.geojson", name) as track,
    ):
        for one in fixes:
            solutions.write(one.fix.solution)
            satellites.write(one.fix.solution)
            track.write(one.fix.solution)
