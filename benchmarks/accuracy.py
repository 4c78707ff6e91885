"""Code and carrier phase of a run against its recording's true ranges, theory beside them."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from tables import markdown

from deepgnss.evaluate.observables import (
    clock_free,
    dynamic_errors,
    range_errors,
    satellite_accuracy,
    thermal_sigmas,
    usual_satellites,
    with_theory,
)
from deepgnss.evaluate.observations import read_channels, read_observations, read_ranges


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path, help="output folder of deepgnss process")
    parser.add_argument("ranges", type=Path, help="ranges.csv of the recording")
    parser.add_argument("--since", type=float, default=0.0, help="s after the first observation")
    parser.add_argument("--until", type=float, default=np.inf, help="s after the first observation")
    parser.add_argument("--mask", type=float, default=0.0, help="elevation mask, deg")
    options = parser.parse_args()
    accuracy = accuracy_of(options.run, options.ranges, options.since, options.until, options.mask)
    print(table_of(accuracy))


def accuracy_of(
    run: Path, ranges_csv: Path, since_s: float = 0.0, until_s: float = np.inf, mask_deg: float = 0
) -> pd.DataFrame:
    """`satellite_accuracy` of a run between two times, with theory and `dynamic_m`."""
    config = json.loads((run / "summary.json").read_text())["config"]
    ranges = read_ranges(ranges_csv)
    errors = range_errors(read_observations(run / "observations.csv"), ranges)
    seconds = (errors["time_ms"] - errors["time_ms"].min()) * 1e-3
    errors = errors[(seconds >= since_s) & (seconds <= until_s)]
    errors = errors[errors["elevation_deg"] >= mask_deg]
    satellites = usual_satellites(errors)
    thermal = thermal_sigmas(
        errors[errors["satellite"].isin(satellites)],
        read_channels(run / "channels.csv"),
        config["tracking"]["code"]["spacing"],
        config["recording"]["streams"][0]["sample_rate"],
    )
    accuracy = with_theory(satellite_accuracy(errors, satellites), thermal)
    return accuracy.assign(dynamic_m=_dynamic(config, ranges, errors, satellites))


def _dynamic(
    config: dict[str, Any], ranges: pd.DataFrame, errors: pd.DataFrame, satellites: list[str]
) -> pd.Series:
    """RMS of the loop's own dynamic error at the epochs compared, by satellite."""
    carrier = config["tracking"]["carrier"]
    order = int(carrier["loop"][-1])
    dynamic = dynamic_errors(ranges, order, carrier["bandwidth"], carrier["coherent"])
    dynamic = dynamic[dynamic["time_ms"].isin(errors["time_ms"])]
    return (clock_free(dynamic, "phase_m", satellites) ** 2).mean() ** 0.5


_HEADS = (
    *("sat", "elev.", "C/N0", "epochs", "code m", "T(2.25)", "phase mm", "T(2.20)", "loop"),
    *("σ/theory", "code−phase mm/s", "slips"),
)


def table_of(accuracy: pd.DataFrame) -> str:
    """One line per satellite; the last one: root mean squares, and the weighted mean slope.

    code: RMS; phase: σ; loop: the carrier loop's own dynamic error; σ/theory: phase over the root
    sum of T(2.20) and loop.
    """
    columns = ["code_rms_m", "code_thermal_m", "phase_sigma_m", "phase_thermal_m", "dynamic_m"]
    slopes = ("code_minus_phase_mmps", "code_minus_phase_sigma_mmps")
    rows = [
        [
            str(name),
            f"{row['elevation_deg']:.0f}°",
            f"{row['cn0_dbhz']:.1f}",
            f"{row['epochs']:.0f}",
            *_sigmas(row[columns]),
            _slope(row[slopes[0]], row[slopes[1]]),
            f"{row['slips']:.0f}",
        ]
        for name, row in accuracy.iterrows()
    ]
    together = (accuracy[columns] ** 2).mean() ** 0.5
    weights = accuracy[slopes[1]] ** -2.0
    total = weights.sum()
    slope = _slope((accuracy[slopes[0]] * weights).sum() / total, total**-0.5) if total else "–"
    rows.append(["all", *[""] * 3, *_sigmas(together), slope, f"{accuracy['slips'].sum():.0f}"])
    return markdown(_HEADS, rows)


def _slope(mmps: float, sigma_mmps: float) -> str:
    return f"{mmps:+.1f} ± {sigma_mmps:.1f}" if np.isfinite(sigma_mmps) else "–"


def _sigmas(row: pd.Series) -> list[str]:
    code, code_thermal, phase, thermal, dynamic = row
    both = np.hypot(thermal, dynamic)
    metres = [f"{code:.2f}", f"{code_thermal:.2f}"]
    return metres + [f"{1e3 * x:.2f}" for x in (phase, thermal, dynamic)] + [f"{phase / both:.2f}"]


if __name__ == "__main__":
    main()
