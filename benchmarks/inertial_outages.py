"""Positions withheld along a real car drive: errors of the inertial navigation, and its own σ.

The drive is that of github.com/rtklibexplorer/GNSS_IMU: a consumer unit at 100 Hz, RTK at 4 Hz.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from tables import markdown

from deepgnss.deep.loose import LooseRun, read_inputs, run_loose
from deepgnss.evaluate.inertial import outage_statistics, outages_along
from deepgnss.io.config import load_config

LENGTHS_S = (10.0, 30.0, 60.0)
PLACES = 10
DRIVING_S = (75.0, 525.0)  # settled, and under way
CONFIG = Path(__file__).with_name("car_drive.yaml")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="with imu_1934.csv, its .tag, gnss_1934_sf.pos")
    parser.add_argument("--set", dest="overrides", action="append", default=[], help="KEY=VALUE")
    options = parser.parse_args()
    rows = []
    for name, overrides in (("free", ["ins.vehicle=null"]), ("held by the road", [])):
        run = drive(options.folder, [*overrides, *options.overrides])
        for length_s in LENGTHS_S:
            from_s = np.linspace(DRIVING_S[0], DRIVING_S[1] - length_s, PLACES)
            s = outage_statistics(outages_along(run, length_s, from_s))
            rows.append(
                [
                    name,
                    f"{length_s:g} s",
                    f"{s.places}",
                    f"{s.rms_m:.2f}",
                    f"{s.largest_m:.2f}",
                    f"{s.sigma_m:.2f}",
                    f"{s.ratio:.2f}",
                    f"{s.worst_ratio:.2f}",
                    f"{s.nees:.2f}",
                ]
            )
    heads = ["", "withheld", "places", "RMS m", "largest m", "1σ m", "error/σ", "worst", "NEES/3"]
    print(markdown(heads, rows))


def drive(folder: Path, overrides: list[str]) -> LooseRun:
    """The whole drive with all its fixes."""
    imu = folder / "imu_1934.csv"
    files = [f"imu.file={imu.resolve()}", f"imu.tag_file={imu.resolve()}.tag"]
    config = load_config(CONFIG, [*files, "ins.smoother=false", *overrides])
    return run_loose(config, read_inputs(config, folder / "gnss_1934_sf.pos"))


if __name__ == "__main__":
    main()
