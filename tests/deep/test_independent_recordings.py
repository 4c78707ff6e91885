"""Recordings from simulators other people wrote, through the whole program.

What comes out is held against their truth, and read by programs other people wrote.
"""

from __future__ import annotations

import json
import math
import shutil
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import georinex
import numpy as np
import pandas as pd
import pymap3d
import pytest
import yaml
from pynmeagps import NMEAReader

from deepgnss.core.frames import ecef
from deepgnss.core.records import FloatArray
from deepgnss.core.time import GpsTime
from deepgnss.io.rinex_nav import read_nav
from deepgnss.receiver.orbits import predict, select

_TRUTH = ("lat_deg", "lon_deg", "height_m")


@dataclass(frozen=True)
class Case:
    """A recording, how to process it, and what it must give."""

    folder: str
    samples: str
    nav: str
    config: dict[str, Any]
    unhealthy: tuple[str, ...]
    causal_fix_s: float
    rms_m: float
    signals: tuple[str, ...] = ("GPS_L1CA",)
    other_samples: str = ""  # of a second stream


def _stream(name: str, rate_hz: float = 2.6e6, centre_hz: float = 1575.42e6) -> dict[str, Any]:
    return {
        "name": name,
        "format": "bits1",
        "samples": "iq",
        "packing": {"order": "msb_first", "code": "sign_magnitude"},
        "sample_rate": rate_hz,
        "centre_frequency": centre_hz,
        "intermediate_frequency": 0.0,
    }


DRIVE = Case(
    folder="drive",
    samples="rec.bin",
    nav="brdc0010.22n",
    config={
        "recording": {"streams": [_stream("L1")]},
        "tracking": {"carrier": {"loop": "pll3", "bandwidth": 15.0, "coherent": 0.02}},
        "positioning": {"troposphere": "none"},  # as simulated
    },
    unhealthy=("G22",),
    causal_fix_s=24.0,
    rms_m=1.5,
)
DUAL = Case(
    folder="dual",
    samples="l1.bin",
    nav="ESBC00DNK_R_20201770000_01D_MN.rnx.gz",
    config={"recording": {"streams": [_stream("L1")]}},
    unhealthy=(),
    causal_fix_s=31.0,
    rms_m=2.0,
)
TWO_SYSTEMS = replace(
    DUAL,
    config={"recording": {"streams": [_stream("L1"), _stream("B1", 4.5e6, 1561.098e6)]}},
    causal_fix_s=35.0,
    rms_m=2.5,
    signals=("GPS_L1CA", "BDS_B1I"),
    other_samples="b1.bin",
)
each = pytest.mark.parametrize(
    "case", [DRIVE, DUAL, TWO_SYSTEMS], ids=["drive", "dual-gps", "dual"]
)


@dataclass(frozen=True)
class Outcome:
    """The outputs of a run."""

    folder: Path
    truth_csv: Path

    @cached_property
    def summary(self) -> dict[str, Any]:
        return dict(json.loads((self.folder / "summary.json").read_text()))

    @cached_property
    def solutions(self) -> pd.DataFrame:
        table = pd.read_csv(self.folder / "solution.csv")
        return table[table["valid"] == 1]

    @cached_property
    def observations(self) -> pd.DataFrame:
        return pd.read_csv(self.folder / "observations.csv")

    @property
    def observation_file(self) -> Path:
        return next(self.folder.glob("*_?O.rnx"))

    @property
    def navigation_file(self) -> Path:
        return next(self.folder.glob("*_?N.rnx"))

    @cached_property
    def errors_enu_m(self) -> FloatArray:
        """Position errors (epochs, 3)."""
        truth = pd.read_csv(self.truth_csv)
        tow_s = self.solutions["tow_s"].to_numpy()
        lat, lon, height = (np.interp(tow_s, truth["gps_tow_s"], truth[c]) for c in _TRUTH)
        seen = (self.solutions[c].to_numpy() for c in _TRUTH)
        return np.column_stack(pymap3d.geodetic2enu(*seen, lat, lon, height))


Process = Callable[..., Outcome]


@pytest.fixture(scope="module")
def process(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Process:
    """Function that runs `deepgnss process`, each combination once."""
    done: dict[str, Outcome] = {}

    def run(
        case: Case, *, start: str = "scout", nav: bool = False, duration_s: float = 0
    ) -> Outcome:
        key = f"{case.folder}-{len(case.signals)}-{start}-{nav}-{duration_s}"
        if key not in done:
            source = shared_data / "independent" / case.folder
            folder = tmp_path_factory.mktemp(key)
            config = case.config | {
                "signals": list(case.signals),
                "start": start,
                "output": {"interval": 0.1, "report": False},
            }
            if nav:
                config["nav"] = str(source / case.nav)
            if duration_s:
                config["recording"] = case.config["recording"] | {"duration": duration_s}
            if case.other_samples:
                config["recording"]["streams"][1]["file"] = str(source / case.other_samples)
            (folder / "car.yaml").write_text(yaml.safe_dump(config))
            command = Path(sys.executable).parent / "deepgnss"
            ended = subprocess.run(
                [command, "process", source / case.samples, "--config", folder / "car.yaml"],
                capture_output=True,
                text=True,
                check=False,
            )
            assert ended.returncode == 0, ended.stderr
            done[key] = Outcome(folder / "out", source / "truth.csv")
        return done[key]

    return run


def _check_accuracy(outcome: Outcome, case: Case) -> None:
    horizontal_m = np.hypot(*outcome.errors_enu_m[:, :2].T)
    assert np.sqrt(np.mean(horizontal_m**2)) <= case.rms_m
    assert np.max(horizontal_m) < 4.0 * case.rms_m
    assert np.max(np.abs(outcome.solutions["clock_s"])) < 1e-6
    used = set(" ".join(outcome.solutions["satellites"]).split())
    assert not used & set(case.unhealthy)
    assert len(used) >= 7


def _check_phase(outcome: Outcome, quiet_after_s: float) -> None:
    """No slip once things have settled; phase runs as the Doppler says."""
    table = outcome.observations
    table = table[table["carrier_valid"] == 1]
    settled = table["tow_s"] > table["tow_s"].min() + quiet_after_s
    assert table[settled & (table["slip"] == 1)].empty
    assert table[settled & (table["half_cycle"] == 1)].empty
    for _, one in table[settled].groupby("satellite"):
        step_s = np.diff(one["tow_s"])
        doppler = one["doppler_hz"].to_numpy()
        gap = np.diff(one["carrier_cycles"]) + 0.5 * (doppler[1:] + doppler[:-1]) * step_s
        assert np.max(np.abs(gap[step_s < 0.15])) < 0.3


def _check_nmea(outcome: Outcome, interval_s: float) -> None:
    """Every sentence parses, and GGA says where the solution is."""
    kinds: dict[str, int] = {}
    places = []
    with (outcome.folder / "solution.nmea").open("rb") as file:
        for _, sentence in NMEAReader(file, quitonerror=2):
            kinds[sentence.msgID] = kinds.get(sentence.msgID, 0) + 1
            if sentence.msgID == "GGA" and sentence.quality:
                places.append((sentence.lat, sentence.lon))
    assert {"GGA", "RMC", "GSA", "GSV", "VTG", "GST", "ZDA"} <= set(kinds)
    assert len(places) == len(outcome.solutions)
    written = outcome.solutions[["lat_deg", "lon_deg"]].to_numpy()
    np.testing.assert_allclose(np.array(places), written, atol=2e-7)
    assert kinds["GGA"] * interval_s == pytest.approx(outcome.summary["epochs"] * interval_s)


# --- quick ---------------------------------------------------------------------------------------


def test_first_seconds_of_the_drive_with_a_nav_file(process: Process) -> None:
    """Time within a subframe, positions from sample 0 on, clean phase, sentences that parse."""
    outcome = process(DRIVE, nav=True, duration_s=8.0)
    assert outcome.summary["first_fix_s"] < 1.0
    assert outcome.summary["epochs_fixed"] == outcome.summary["epochs"] > 70
    _check_accuracy(outcome, DRIVE)
    _check_phase(outcome, 3.0)
    _check_nmea(outcome, 0.1)


# --- whole recordings ----------------------------------------------------------------------------


@pytest.mark.slow
@each
def test_scouted_fixes_begin_with_the_recording(case: Case, process: Process) -> None:
    outcome = process(case)
    assert outcome.summary["first_fix_s"] <= 3.0
    assert outcome.summary["epochs_fixed"] >= 0.99 * outcome.summary["epochs"]


@pytest.mark.slow
@each
def test_causal_first_fix(case: Case, process: Process) -> None:
    assert process(case, start="causal").summary["first_fix_s"] <= case.causal_fix_s


@pytest.mark.slow
@each
def test_causal_first_fix_with_a_nav_file(case: Case, process: Process) -> None:
    outcome = process(case, start="causal", nav=True)
    assert outcome.summary["first_fix_s"] <= 8.0
    _check_accuracy(outcome, case)


@pytest.mark.slow
@each
def test_positions_and_satellites(case: Case, process: Process) -> None:
    _check_accuracy(process(case), case)


@pytest.mark.slow
@each
def test_no_slips_after_three_seconds(case: Case, process: Process) -> None:
    _check_phase(process(case), 3.0)


@pytest.mark.slow
@each
def test_sentences_parse(case: Case, process: Process) -> None:
    _check_nmea(process(case), 0.1)


@pytest.mark.slow
@each
def test_georinex_reads_what_was_written(case: Case, process: Process) -> None:
    outcome = process(case)
    table = outcome.observations
    begin_s = table["tow_s"].min()
    start = np.datetime64("1980-01-06") + np.timedelta64(int(table["week"].iloc[0]) * 7, "D")
    limits = [start + np.timedelta64(round((begin_s + s) * 1e3), "ms") for s in (10.0, 12.0)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of xarray, about defaults to come
        seen = georinex.load(outcome.observation_file, tlim=[str(limit) for limit in limits])
        nav = georinex.load(outcome.navigation_file)
    times_ms = np.rint((seen.time.to_numpy() - start) / np.timedelta64(1, "ms")).astype(int)
    assert times_ms.size >= 20
    table = table.set_index([table["satellite"], (table["tow_s"] * 1e3).round().astype(int)])
    for satellite in seen.sv.to_numpy():
        wanted = table["pseudorange_m"].loc[satellite].reindex(times_ms)
        code = seen["C1C" if satellite[0] == "G" else "C2I"].sel(sv=satellite).to_numpy()
        np.testing.assert_allclose(code, wanted.to_numpy(), atol=6e-4)
    assert set(" ".join(outcome.solutions["satellites"]).split()) <= set(nav.sv.to_numpy())


@pytest.mark.slow
@each
def test_rtklib_finds_our_positions(case: Case, process: Process, tmp_path: Path) -> None:
    """rnx2rtkp, single point, on our own observation and navigation files."""
    program = shutil.which("rnx2rtkp")
    if program is None:
        pytest.skip("rnx2rtkp is not installed (Debian, Ubuntu: apt install rtklib)")
    outcome, out = process(case), tmp_path / "rtklib.pos"
    atmosphere = {"drive": ("brdc", "off")}.get(case.folder, ("brdc", "saas"))
    settings = tmp_path / "rtk.conf"
    settings.write_text(
        "pos1-posmode=single\npos1-frequency=l1\npos1-elmask=10\npos1-navsys=33\n"
        f"pos1-ionoopt={atmosphere[0]}\npos1-tropopt={atmosphere[1]}\n"
        "out-solformat=llh\nout-timesys=gpst\nout-timeform=tow\n"
    )
    ended = subprocess.run(
        [program, "-k", settings, "-o", out, outcome.observation_file, outcome.navigation_file],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "error" not in ended.stderr.lower()
    rows = np.loadtxt([x for x in out.read_text().splitlines() if x[:1] not in "%"], ndmin=2)
    ours = outcome.solutions
    found = pd.Series(range(len(rows)), index=np.rint(rows[:, 1] * 10).astype(int))
    places = found.reindex(np.rint(ours["tow_s"] * 10).astype(int))
    assert places.notna().all()  # every epoch of ours has one of theirs
    theirs = rows[places.to_numpy().astype(int)]
    east, north, up = pymap3d.geodetic2enu(
        theirs[:, 2], theirs[:, 3], theirs[:, 4], *(ours[c].to_numpy() for c in _TRUTH)
    )
    assert np.max(np.sqrt(east**2 + north**2 + up**2)) < 5.0


@pytest.mark.slow
def test_every_beidou_satellite_in_view_is_tracked(process: Process, shared_data: Path) -> None:
    """MEO, IGSO and GEO alike, in phase lock nearly from the start; ephemerides of all."""
    outcome = process(TWO_SYSTEMS, start="causal")
    nav = read_nav(shared_data / "independent" / "dual" / TWO_SYSTEMS.nav)
    start = GpsTime(2111, 388_818.0)
    place_e_m = ecef(math.radians(55.4935), math.radians(8.4568), 60.0)
    orbits = [orbit for s in nav.ephemerides if s[0] == "C" and (orbit := select(nav, s, start))]
    seen = predict(orbits, start, place_e_m, np.zeros(3))
    high = seen.elevation_rad > math.radians(5.0)
    in_view = {orbit.satellite for orbit, up in zip(orbits, high, strict=True) if up}
    channels = pd.read_csv(outcome.folder / "channels.csv")
    channels = channels[channels["signal"] == "BDS_B1I"]
    locked = channels[(channels["mode"] == "PLL") & (channels["lock_time_s"] > 35.0)]
    assert {"C05", "C06", "C19"} <= in_view  # GEO, IGSO, MEO
    assert set(locked["satellite"]) == in_view
    decoded = read_nav(outcome.navigation_file)
    assert in_view <= set(decoded.ephemerides)
    for satellite in in_view:
        (ours,) = decoded.ephemerides[satellite]
        theirs = min(nav.ephemerides[satellite], key=lambda e: abs(e.toe.since(ours.toe)))
        assert ours.toe == theirs.toe
        assert ours.sqrt_a_rm == pytest.approx(theirs.sqrt_a_rm, rel=1e-10)
        assert ours.m0_rad == pytest.approx(theirs.m0_rad, abs=1e-8)
