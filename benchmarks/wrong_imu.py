"""What a wrong inertial log costs: the same recording with logs that are not its own, and without.

    python benchmarks/wrong_imu.py [--seeds 1 2] [--seconds 75]

Every run is one of `deepgnss process` on a short city drive (trees, footbridge, tunnel, canyon).
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import pandas as pd
from tables import markdown

from deepgnss.core.frames import C_ne, ecef, geodetic
from deepgnss.evaluate.observables import range_errors, satellite_accuracy
from deepgnss.evaluate.observations import read_observations, read_ranges

DEEPGNSS = Path(sys.executable).parent / "deepgnss"
GYRO_BIAS_RADPS, ACCEL_BIAS_MPS2 = 15.0 * math.pi / 180.0 / 3600.0, 800e-5  # MTi-G
SCENARIO = (
    "streams=[{name: L1, format: bits2, sample_rate: 2.61e6, centre_frequency: 1575.42e6}]",
    "satellites={systems: [GPS], mask: 8, limit: 10, cn0: {zenith: 48, horizon: 38}}",
)
Change = Callable[[pd.DataFrame], pd.DataFrame]
_TIMES, _GYROS, _ACCELS = slice(0, 2), slice(2, 5), slice(5, 8)  # columns of the log


def right(log: pd.DataFrame) -> pd.DataFrame:
    """The log as it is."""
    return log


def swapped(log: pd.DataFrame) -> pd.DataFrame:
    """The log of a unit whose axes are right, forward, up, taken for FRD."""
    changed = log.copy()
    for axes in (_GYROS, _ACCELS):
        x, y, z = log.iloc[:, axes].to_numpy().T
        changed.iloc[:, axes] = np.column_stack([y, x, -z])
    return changed


def left_handed(log: pd.DataFrame) -> pd.DataFrame:
    """Two axes swapped, the third as it was."""
    changed = log.copy()
    for axes in (_GYROS, _ACCELS):
        changed.iloc[:, axes] = log.iloc[:, axes].to_numpy()[:, [1, 0, 2]]
    return changed


def late(log: pd.DataFrame) -> pd.DataFrame:
    """Stamps 0.1 s late."""
    changed = log.copy()
    changed.iloc[:, 1] = (log.iloc[:, 1] + 0.1).round(6)
    return changed


def biased(log: pd.DataFrame) -> pd.DataFrame:
    """Ten times the biases of its grade on top."""
    changed, dt_s = log.copy(), float(np.median(np.diff(log.iloc[:, 1])))
    signs = np.array([1.0, -1.0, 1.0])
    changed.iloc[:, _GYROS] += 10.0 * GYRO_BIAS_RADPS * dt_s * signs
    changed.iloc[:, _ACCELS] += 10.0 * ACCEL_BIAS_MPS2 * dt_s * signs
    return changed


def another(log: pd.DataFrame) -> pd.DataFrame:
    """Another drive: the same street, begun 23 s later."""
    rows = round(23.0 / float(np.median(np.diff(log.iloc[:, 1]))))
    changed = log.copy()
    changed.iloc[:, 2:] = np.roll(log.iloc[:, 2:].to_numpy(), rows, axis=0)
    return changed


LOGS: dict[str, Change] = {
    "right": right,
    "axes RFU for FRD": swapped,
    "axes left-handed": left_handed,
    "0.1 s late": late,
    "biases ×10": biased,
    "another drive's": another,
}
HEADS = (
    *("log", "fixed", "horizontal RMS / 95 % m", "satellites lost", "phase arcs", "slips"),
    *("phase mm", "aided s", "warning"),
)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--seconds", type=float, default=75.0)
    parser.add_argument("--logs", nargs="+", choices=LOGS, default=list(LOGS))
    options = parser.parse_args()
    for seed in options.seeds:
        with TemporaryDirectory(prefix="deepgnss-") as folder:
            drive = simulated(Path(folder), seed)
            changes = {"deep: false": None} | {name: LOGS[name] for name in options.logs}
            rows = [
                [name, *processed(drive, change, options.seconds).row()]
                for name, change in changes.items()
            ]
            print(f"\nseed {seed}\n\n{markdown(HEADS, rows)}", flush=True)


def simulated(folder: Path, seed: int) -> Path:
    """A short drive through a city."""
    settings = [part for setting in (*SCENARIO, f"seed={seed}") for part in ("--set", setting)]
    command = [DEEPGNSS, "simulate", "urban_short", "--output", folder, *settings]
    subprocess.run(command, check=True, capture_output=True)
    return folder


class Figures(NamedTuple):
    """What a run came to."""

    fixed: float  # share of the epochs
    rms_m: float  # horizontal
    percentile95_m: float
    lost: int  # satellites
    arcs: int  # of phase, of the five highest satellites
    slips: int  # possible ones, of all
    phase_mm: float  # of the five highest, against truth
    aided_s: float
    warnings: tuple[str, ...]
    errors_m: pd.Series  # horizontal, by ms of week

    def row(self) -> list[str]:
        """Cells of the table."""
        return [
            f"{100.0 * self.fixed:.1f} %",
            f"{self.rms_m:.2f} / {self.percentile95_m:.2f}",
            *(str(count) for count in (self.lost, self.arcs, self.slips)),
            f"{self.phase_mm:.2f}",
            f"{self.aided_s:.0f}",
            " ".join(self.warnings) or "–",
        ]


def processed(drive: Path, change: Change | None, seconds: float) -> Figures:
    """One run, with a log or unaided."""
    place = pd.read_csv(drive / "truth.csv", nrows=1)[["lat_deg", "lon_deg", "height_m"]]
    settings = {
        "start": "causal",
        "nav": drive / "nav.rnx",
        "position": place.iloc[0].tolist(),
        "recording.duration": seconds,
        "output.interval": 0.2,
        "output.report": "false",
        "output.nmea": "false",
        "deep": "false" if change is None else "true",
        "threads": 1,
        "output.directory": drive / "out",
    }
    if change is not None:
        change(pd.read_csv(drive / "imu.csv")).to_csv(drive / "changed.csv", index=False)
        settings["imu.file"] = drive / "changed.csv"
    given = [part for key, value in settings.items() for part in ("--set", f"{key}={value}")]
    command = [DEEPGNSS, "process", drive / "rec.bin", "--config", drive / "config.yaml", *given]
    subprocess.run(command, check=True, capture_output=True)
    return figures(drive)


def figures(drive: Path) -> Figures:
    """Read a run's outputs against the truth."""
    out = drive / "out"
    solution = pd.read_csv(out / "solution.csv")
    observed = pd.read_csv(out / "observations.csv", low_memory=False)
    lost = int((pd.read_csv(out / "events.csv")["what"] == "lost").sum())
    phase = observed[observed["carrier_valid"] == 1]
    valid = solution[solution["valid"] == 1]
    errors_m = horizontal_m(valid, pd.read_csv(drive / "truth.csv"))
    (rinex,) = out.glob("*O.rnx")
    told = read_observations(rinex)
    whole = told["carrier_cycles"].where(~told["half_cycle"])
    errors = range_errors(told.assign(carrier_cycles=whole), read_ranges(drive / "ranges.csv"))
    high = sorted(errors.groupby("satellite")["elevation_deg"].mean().nlargest(5).index)
    accuracy = satellite_accuracy(errors, high)
    phase_mm = 1e3 * float(np.sqrt((accuracy["phase_sigma_m"] ** 2).mean()))
    inertial = json.loads((out / "summary.json").read_text()).get("inertial", {})
    return Figures(
        len(valid) / len(solution),
        float(np.sqrt(np.mean(errors_m**2))),
        float(np.quantile(errors_m, 0.95)),
        lost,
        int(accuracy["arcs"].sum()),
        int((phase["slip"] == 1).sum()),
        phase_mm,
        inertial.get("trusted_s", 0.0),
        tuple(inertial.get("warnings", ())),
        pd.Series(errors_m, (valid["tow_s"] * 1e3).round().astype(int)),
    )


def horizontal_m(solution: pd.DataFrame, truth: pd.DataFrame) -> np.ndarray:
    """Horizontal errors of positions."""

    def places(table: pd.DataFrame) -> np.ndarray:
        lat, lon = (np.radians(table[name].to_numpy()) for name in ("lat_deg", "lon_deg"))
        return np.array([ecef(*p) for p in zip(lat, lon, table["height_m"], strict=True)])

    there, seen = places(truth), places(solution)
    true = np.column_stack(
        [np.interp(solution["tow_s"], truth["gps_tow_s"], column) for column in there.T]
    )
    lat_rad, lon_rad, _ = geodetic(there[0])
    return np.asarray(np.hypot(*((seen - true) @ C_ne(lat_rad, lon_rad).T)[:, :2].T))


if __name__ == "__main__":
    main()
