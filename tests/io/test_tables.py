import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from run_samples import NOON, epoch, no_solution, observation, solution

from deepgnss.core.records import ChannelReport, Event
from deepgnss.io.output import part_path
from deepgnss.io.tables import (
    ChannelTable,
    EventTable,
    ObservationTable,
    SatelliteTable,
    SolutionTable,
    number,
)


def test_solution_row(tmp_path: Path) -> None:
    path = tmp_path / "solution.csv"
    with SolutionTable(path) as table:
        table.write(no_solution("3 satellites, 4 needed"))
        table.write(solution(time=NOON.plus(0.1)))
    frame = pd.read_csv(path)
    none, row = frame.iloc[0], frame.iloc[1]
    assert np.isnan(none["source"])
    assert (none["valid"], none["reason"]) == (0, "3 satellites, 4 needed")
    assert none[["lat_deg", "x_e_m", "v_n_mps", "sigma_d_m", "hdop"]].isna().all()
    assert (row["week"], row["tow_s"], row["valid"]) == (2190, 561_628.1, 1)
    assert row["lat_deg"] == pytest.approx(48.0, abs=1e-10)
    assert row["lon_deg"] == pytest.approx(11.5, abs=1e-10)
    assert row["height_m"] == pytest.approx(512.25, abs=1e-4)
    assert row[["v_n_mps", "v_e_mps", "v_d_mps"]].tolist() == [3.0, 4.0, -0.5]
    assert row[["sigma_n_m", "sigma_e_m", "sigma_d_m", "sigma_clock_m"]].tolist() == [2, 1, 3, 4]
    assert row[["sigma_vn_mps", "sigma_ve_mps", "sigma_vd_mps"]].tolist() == [0.2, 0.1, 0.3]
    assert (row["clock_s"], row["drift_sps"]) == (1.5e-7, -2.5e-9)
    assert (row["used"], row["satellites"]) == (4, "G05 G12 G25 G31")
    assert row["rejected"] == "G22 unhealthy"
    assert row["source"] == "gnss"


def test_every_row_has_every_column(tmp_path: Path) -> None:
    report = ChannelReport(
        "G05", "GPS_L1CA", "bit sync", "PLL", 45.0, -1234.5, 0.99, math.nan, 1.5, 0.02, 15.0, 1.0
    )
    with (
        SolutionTable(tmp_path / "a.csv") as a,
        SatelliteTable(tmp_path / "b.csv") as b,
        ChannelTable(tmp_path / "c.csv") as c,
        ObservationTable(tmp_path / "d.csv") as d,
        EventTable(tmp_path / "e.csv", 4.0e6) as e,
    ):
        for fix in (solution(), no_solution()):
            a.write(fix)
            b.write(fix)
        c.write(0.1, None, [report])
        c.write(0.2, NOON, [report])
        d.write(epoch([observation(), observation("G12", doppler_hz=math.nan)]))
        e.write([Event(4_000_000, "G05", "PLL → lost", 'said "no lock",\n twice')])
    for path in sorted(tmp_path.iterdir()):
        with path.open(newline="") as stream:
            rows = list(csv.reader(stream))
        assert {len(row) for row in rows} == {len(rows[0])}, path
        assert len(rows) > 1
    channels = pd.read_csv(tmp_path / "c.csv")
    assert channels["tow_s"].isna().tolist() == [True, False]
    assert channels["aiding_minus_loop_hz"].isna().all()
    events = pd.read_csv(tmp_path / "e.csv")
    assert events.loc[0, "recording_s"] == 1.0
    assert events.loc[0, "reason"] == 'said "no lock",\n twice'


def test_satellites_of_an_epoch(tmp_path: Path) -> None:
    with SatelliteTable(tmp_path / "s.csv") as table:
        table.write(solution(rejected={"G22": "unhealthy", "G30": "no ephemeris"}))
    frame = pd.read_csv(tmp_path / "s.csv").set_index("satellite")
    assert frame.index.tolist() == ["G05", "G12", "G22", "G25", "G30", "G31"]
    assert frame["used"].tolist() == [1, 1, 0, 1, 0, 1]
    assert frame.loc["G12", "azimuth_deg"] == pytest.approx(359.7)
    assert frame.loc["G05", "elevation_deg"] == pytest.approx(math.degrees(1.0), abs=1e-3)
    assert frame.loc["G22", "residual_m"] == 40.0
    assert frame.loc["G30", "rejected"] == "no ephemeris"


def test_transmission_time_keeps_its_digits(tmp_path: Path) -> None:
    sent = NOON.plus(-0.070_123_456_789)
    with ObservationTable(tmp_path / "o.csv") as table:
        table.write(epoch([observation(transmit=sent)]))
    with (tmp_path / "o.csv").open() as stream:
        (row,) = csv.DictReader(stream)
    assert float(row["transmit_tow_s"]) == pytest.approx(sent.tow_s, abs=1e-10, rel=0)


def test_rows_so_far_are_readable_while_the_run_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "solution.csv"
    table = SolutionTable(path)
    for k in range(3):
        table.write(replace(solution(), time=NOON.plus(k)))
        table.flush()
        assert len(pd.read_csv(part_path(path))) == k + 1
    table.close()


@pytest.mark.parametrize(
    ("value", "text"),
    [(-0.0004, "0.000"), (-0.0006, "-0.001"), (math.nan, ""), (math.inf, ""), (2.0, "2.000")],
)
def test_number(value: float, text: str) -> None:
    assert number(value, 3) == text
    assert number(np.float64(value), 3) == text
