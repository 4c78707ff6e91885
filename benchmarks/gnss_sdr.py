"""GNSS-SDR on a recording of ours: configuration, run, and what came of it."""

from __future__ import annotations

import re
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
import pandas as pd

from deepgnss.core.frames import C_ne, geodetic
from deepgnss.evaluate.child import run
from deepgnss.evaluate.observations import read_observations
from deepgnss.io.config import Config
from deepgnss.io.recording import Recording

# Tracking as its documentation has it (docs/sp-blocks/tracking, GPS_L1_CA_DLL_PLL_Tracking).
DEFAULTS: Mapping[str, str] = {}  # 1 ms sums, PLL 35 Hz, DLL 2 Hz (what 0.0.17 falls back to)
EXAMPLE: Mapping[str, str] = {
    "extend_correlation_symbols": "20",
    "early_late_space_chips": "0.5",
    "early_late_space_narrow_chips": "0.1",
    "pll_bw_hz": "35",
    "dll_bw_hz": "2.0",
    "pll_bw_narrow_hz": "5.0",
    "dll_bw_narrow_hz": "0.50",
    "fll_bw_hz": "10",
    "enable_fll_pull_in": "true",
    "enable_fll_steady_state": "false",
}


# Between the two: the example's sums and bandwidths lose satellites when a car moves.
SHORTER: Mapping[str, str] = {
    "extend_correlation_symbols": "5",
    "early_late_space_chips": "0.5",
    "early_late_space_narrow_chips": "0.2",
    "pll_bw_hz": "30",
    "dll_bw_hz": "2.0",
    "pll_bw_narrow_hz": "15",
    "dll_bw_narrow_hz": "0.5",
}


class Outcome(NamedTuple):
    """What a receiver made of a recording."""

    name: str
    observed: pd.DataFrame  # as of read_observations
    solution: pd.DataFrame  # as of evaluate.errors.read_solution
    bit_sync_s: Mapping[str, float]  # s of recording, by satellite
    cpu_s: float
    first_fixes_tow_s: tuple[float, ...]  # of every run made (NaN: none), this one's first

    @property
    def fixes(self) -> pd.DataFrame:
        """Rows of the solution that are one."""
        return self.solution[self.solution["valid"] == 1]


def best_of(outcomes: Sequence[Outcome]) -> Outcome:
    """The run with the earliest fix (runs of GNSS-SDR differ), the others' first fixes kept."""
    several = sorted(outcomes, key=lambda o: np.nan_to_num(o.first_fixes_tow_s[0], nan=np.inf))
    return several[0]._replace(first_fixes_tow_s=tuple(o.first_fixes_tow_s[0] for o in several))


def installed() -> str | None:
    """Path of the program, None where it is not installed."""
    return shutil.which("gnss-sdr")


def version(program: str) -> str:
    """Its version."""
    return run([program, "--version"]).output.split()[-1]


def write_samples(recording: Recording, path: Path) -> None:
    """The first stream as int8 I, Q; complex samples about zero frequency are what is needed."""
    stream = recording.streams[0]
    if not stream.is_complex or stream.intermediate_hz != 0.0:
        raise SystemExit(f"stream {stream.name}: only complex samples at zero IF are passed on")
    with path.open("wb") as file:
        for first in range(0, stream.sample_count, 1 << 20):
            count = min(1 << 20, stream.sample_count - first)
            samples = recording.read(0, first, count).samples
            np.clip(samples, -127, 127).astype(np.int8).tofile(file)


class Names(NamedTuple):
    """What its configuration calls a signal."""

    short: str
    long: str


GPS_L1CA = Names("1C", "GPS_L1_CA")
BDS_B1I = Names("B1", "BEIDOU_B1I")


def configuration(
    samples: Path,
    config: Config,
    tracking: Mapping[str, str],
    channels: int,
    signal: Names = GPS_L1CA,
) -> str:
    """A configuration file for one signal, models and elevation mask as in a config of ours."""
    rate_hz = round(config.recording.streams[0].sample_rate)
    interval_ms = round(config.output.interval * 1e3)
    positioning = config.positioning
    kind = signal.short
    values = {
        "GNSS-SDR.internal_fs_sps": rate_hz,
        "SignalSource.implementation": "File_Signal_Source",
        "SignalSource.filename": samples,
        "SignalSource.item_type": "ibyte",
        "SignalSource.sampling_frequency": rate_hz,
        "SignalSource.samples": 0,
        "SignalConditioner.implementation": "Signal_Conditioner",
        "DataTypeAdapter.implementation": "Ibyte_To_Complex",
        "InputFilter.implementation": "Pass_Through",
        "InputFilter.item_type": "gr_complex",
        "Resampler.implementation": "Pass_Through",
        "Resampler.item_type": "gr_complex",
        f"Channels_{kind}.count": channels,
        "Channels.in_acquisition": 1,
        f"Acquisition_{kind}.implementation": f"{signal.long}_PCPS_Acquisition",
        f"Acquisition_{kind}.item_type": "gr_complex",
        f"Acquisition_{kind}.pfa": 0.01,
        f"Acquisition_{kind}.doppler_max": round(config.acquisition.doppler_max),
        f"Acquisition_{kind}.doppler_step": 250,
        # its default, 1, finds half as many satellites here
        f"Acquisition_{kind}.max_dwells": 4,
        f"Tracking_{kind}.implementation": f"{signal.long}_DLL_PLL_Tracking",
        f"Tracking_{kind}.item_type": "gr_complex",
        **{f"Tracking_{kind}.{key}": value for key, value in tracking.items()},
        f"TelemetryDecoder_{kind}.implementation": f"{signal.long}_Telemetry_Decoder",
        "Observables.implementation": "Hybrid_Observables",
        "PVT.implementation": "RTKLIB_PVT",
        "PVT.positioning_mode": "Single",
        "PVT.iono_model": "Broadcast" if positioning.ionosphere == "klobuchar" else "OFF",
        "PVT.trop_model": "Saastamoinen" if positioning.troposphere == "saastamoinen" else "OFF",
        "PVT.elevation_mask": positioning.elevation_mask,
        "PVT.output_rate_ms": interval_ms,
        "PVT.rinexobs_rate_ms": interval_ms,
        "PVT.display_rate_ms": 1000,
        "PVT.rinex_version": 3,
        "PVT.dump": "true",
        "PVT.dump_filename": "./pvt",
    }
    return "\n".join(["[GNSS-SDR]", *(f"{key}={value}" for key, value in values.items()), ""])


def outcome(program: str, name: str, folder: Path, text: str) -> Outcome:
    """Run it in a folder of its own."""
    folder.mkdir()
    (folder / "receiver.conf").write_text(text)
    child = run([program, "-c=receiver.conf", "-log_dir=."], folder)
    (folder / "screen.txt").write_text(child.output)
    observed = [read_observations(file) for file in sorted(folder.glob("GSDR*O"))[:1]]
    solution = _solution(folder / "pvt.mat")
    return Outcome(
        name,
        observed[0] if observed else read_nothing(),
        solution,
        bit_sync_times_s(child.output),
        child.cpu_s,
        (float(solution["tow_s"].min()),),
    )


def read_nothing() -> pd.DataFrame:
    """Observations of a receiver that made none."""
    return pd.DataFrame({"week": [], "tow_s": [], "satellite": [], "carrier_cycles": []})


_STEERED_S = 0.01  # clock offset of a fix made once its clock had been set
_TIME = re.compile(r"Current receiver time: (?:(\d+) h )?(?:(\d+) min )?(\d+) s")
_SYNC = re.compile(r"bit synchronization locked in channel \d+ for satellite GPS PRN (\d+)")


def bit_sync_times_s(screen: str) -> dict[str, float]:
    """When each satellite's bits were found, whole seconds of recording, rounded down."""
    found: dict[str, float] = {}
    now_s = 0.0
    for line in screen.splitlines():
        if told := _TIME.search(line):
            hours, minutes, seconds = (float(part or 0) for part in told.groups())
            now_s = 3600.0 * hours + 60.0 * minutes + seconds
        elif locked := _SYNC.search(line):
            found.setdefault(f"G{int(locked[1]):02d}", now_s)
    return found


def _solution(path: Path) -> pd.DataFrame:
    """Its fixes as a solution.csv of ours has them, at the true time of each."""
    columns = ("week", "tow_s", "valid", "x_e_m", "y_e_m", "z_e_m", "v_n_mps", "v_e_mps", "v_d_mps")
    if not path.exists():
        return pd.DataFrame(columns=list(columns))
    with h5py.File(path) as file:
        column = {key: np.asarray(file[key]).ravel().astype(np.float64) for key in file}
    r_e_m = np.column_stack([column[f"pos_{axis}"] for axis in "xyz"])
    v_e_mps = np.column_stack([column[f"vel_{axis}"] for axis in "xyz"])
    v_n_mps = [C_ne(*geodetic(r)[:2]) @ v for r, v in zip(r_e_m, v_e_mps, strict=True)]
    rows = np.column_stack(
        [
            column["week"],
            column["RX_time"] - column["user_clk_offset"],
            np.ones(len(r_e_m)),
            r_e_m,
            np.reshape(v_n_mps, (-1, 3)),
        ]
    )
    steered = np.abs(column["user_clk_offset"]) < _STEERED_S
    return pd.DataFrame(rows[steered], columns=list(columns))
