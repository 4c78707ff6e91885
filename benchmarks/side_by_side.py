"""GNSS-SDR and deepgnss on one recording with known truth: one table of what came out."""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from datetime import date
from importlib.metadata import version
from pathlib import Path

import gnss_sdr
import numpy as np
import pandas as pd
from gnss_sdr import Outcome
from numpy.typing import NDArray
from tables import markdown

from deepgnss.core.records import FloatArray
from deepgnss.evaluate.child import DEEPGNSS, run
from deepgnss.evaluate.errors import errors, read_solution
from deepgnss.evaluate.observables import range_errors, same_epochs, single_differences
from deepgnss.evaluate.observations import read_observations, read_ranges
from deepgnss.io.config import Config, load_config
from deepgnss.io.recording import Recording
from deepgnss.io.truth import Trajectory, read_truth

_SHARE = 0.5  # of the common epochs, that a satellite must be in to be compared


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--config", type=Path, required=True, help="with truth, output.interval")
    parser.add_argument("--set", action="append", default=[], help="as of deepgnss process")
    parser.add_argument("--ranges", type=Path, required=True, help="ranges.csv of the recording")
    parser.add_argument("--channels", type=int, default=11, help="of GNSS-SDR")
    parser.add_argument("--runs", type=int, default=3, help="of GNSS-SDR; the best one counts")
    parser.add_argument("--keep", type=Path, help="folder for all that is written")
    options = parser.parse_args()
    program = gnss_sdr.installed()
    if program is None:
        raise SystemExit("gnss-sdr is not installed (Debian, Ubuntu: apt-get install gnss-sdr)")
    config = load_config(options.config, tuple(options.set))
    if config.truth is None:
        raise SystemExit(f"{options.config}: truth: needed here")
    truth = read_truth(config.truth.file, config.truth.format)
    with ExitStack() as stack:
        folder = options.keep or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder.mkdir(parents=True, exist_ok=True)
        outcomes = [
            *(_ours(options, folder / start, start) for start in ("scout", "causal")),
            *_theirs(program, options, config, folder),
        ]
        start_tow_s = _start_tow_s(folder / "causal", outcomes[1])
    print(
        f"GNSS-SDR {gnss_sdr.version(program)}, deepgnss {version('deepgnss')}, {date.today()}\n"
        f"{_versus(outcomes, truth, read_ranges(options.ranges), start_tow_s)}"
    )


def _ours(options: argparse.Namespace, folder: Path, start: str) -> Outcome:
    settings = [f"start={start}", *options.set]
    chosen = [part for setting in settings for part in ("--set", setting)]
    command = [*DEEPGNSS, "process", str(options.recording), "--config", str(options.config)]
    if start == "scout":  # kernels are compiled once for good, before anything is timed
        run([*command, *chosen, "-o", str(folder)])
    child = run([*command, *chosen, "-o", str(folder)])
    events = pd.read_csv(folder / "events.csv")
    synced = events[events["what"] == "bit sync"].groupby("satellite")["recording_s"].min()
    solution = read_solution(folder / "solution.csv")
    return Outcome(
        f"deepgnss, {start}",
        read_observations(folder / "observations.csv"),
        solution,
        {str(name): float(time) for name, time in synced.items()},
        child.cpu_s,
        (float(solution.loc[solution["valid"] == 1, "tow_s"].min()),),
    )


def _theirs(
    program: str, options: argparse.Namespace, config: Config, folder: Path
) -> list[Outcome]:
    samples = (folder / "samples.i8").resolve()
    formats = tuple(stream.stream_format() for stream in config.recording.streams[:1])
    with Recording(formats, options.recording) as recording:
        gnss_sdr.write_samples(recording, samples)
    kinds = {
        "defaults": gnss_sdr.DEFAULTS,
        "20 ms": gnss_sdr.EXAMPLE,
        "5 ms": gnss_sdr.SHORTER,
    }
    found = []
    for name, tracking in kinds.items():
        text = gnss_sdr.configuration(samples, config, tracking, options.channels)
        runs = [
            gnss_sdr.outcome(
                program, f"GNSS-SDR, {name}", folder / f"{name.replace(' ', '-')}-{k}", text
            )
            for k in range(options.runs)
        ]
        found.append(gnss_sdr.best_of(runs))
    samples.unlink()
    return found


def _start_tow_s(folder: Path, outcome: Outcome) -> float:
    """GPST of sample 0."""
    summary = json.loads((folder / "summary.json").read_text())
    return outcome.first_fixes_tow_s[0] - float(summary["first_fix_s"])


def _versus(
    outcomes: Sequence[Outcome], truth: Trajectory, ranges: pd.DataFrame, start_tow_s: float
) -> str:
    measured = [o for o in outcomes if o.observed["carrier_cycles"].notna().any()]
    compared = same_epochs([range_errors(o.observed, ranges) for o in measured])
    counts = compared[0].groupby("satellite").size()
    satellites = list(counts.index[counts >= _SHARE * compared[0]["time_ms"].nunique()])
    compared = [e[e["satellite"].isin(satellites)] for e in compared]
    reference = str(compared[0].groupby("satellite")["cn0_dbhz"].mean().idxmax())
    differences = {
        o.name: single_differences(e, reference) for o, e in zip(measured, compared, strict=True)
    }
    times = _common_fixes(outcomes)
    columns = [_column(o, truth, start_tow_s, times, differences.get(o.name)) for o in outcomes]
    rows = [[head, *(column[head] for column in columns)] for head in columns[0]]
    seconds = (compared[0]["time_ms"].max() - compared[0]["time_ms"].min()) * 1e-3
    return "\n\n".join(
        [
            markdown(["", *(o.name for o in outcomes)], rows),
            f"Differences against {reference}, {seconds:.1f} s that all have "
            "(code σ in m, phase σ in mm):",
            _by_satellite(differences),
        ]
    )


def _by_satellite(differences: dict[str, pd.DataFrame]) -> str:
    names = next(iter(differences.values())).index
    rows = [
        [
            str(name),
            *(
                f"{d.loc[name, 'code_sigma_m']:.2f}, {1e3 * d.loc[name, 'phase_sigma_m']:.2f}"
                for d in differences.values()
            ),
        ]
        for name in names
    ]
    return markdown(["sat", *differences], rows)


def _common_fixes(outcomes: Sequence[Outcome]) -> set[int]:
    """Times of fix, 0.1 s of week, that every receiver with a fix has."""
    times = [set(_tenths(o.fixes["tow_s"])) for o in outcomes if len(o.fixes)]
    return set.intersection(*times)


def _tenths(tow_s: pd.Series) -> NDArray[np.int64]:
    return np.round(tow_s.to_numpy(np.float64) * 10.0).astype(np.int64)


def _column(
    o: Outcome,
    truth: Trajectory,
    start_tow_s: float,
    times: set[int],
    differences: pd.DataFrame | None,
) -> dict[str, str]:
    fixes = o.fixes
    first, *others = (
        f"{tow_s - start_tow_s:.1f}" if np.isfinite(tow_s) else "–" for tow_s in o.first_fixes_tow_s
    )
    every = errors(fixes, truth)
    common = errors(fixes[np.isin(_tenths(fixes["tow_s"]), list(times))], truth)
    tracked = sorted(o.observed["satellite"].unique())
    syncs = sorted(o.bit_sync_s.values())
    rms = {} if differences is None else (differences**2).mean() ** 0.5
    return {
        "satellites with observations": str(len(tracked)),
        "bits found, s: first, median, last": ", ".join(
            f"{x:.1f}" for x in (syncs[0], np.median(syncs), syncs[-1])
        )
        if syncs
        else "–",
        "first fix, s": f"{first} (other runs {', '.join(others)})" if others else first,
        "horizontal RMS, all its fixes, m": _rms(every.horizontal_m),
        f"horizontal RMS, the {len(times)} common fixes, m": _rms(common.horizontal_m),
        "north, common fixes, m": _spread(common.north_m),
        "east, common fixes, m": _spread(common.east_m),
        "down, common fixes, m": _spread(common.down_m),
        "code σ of differences, m": f"{rms['code_sigma_m']:.2f}" if len(rms) else "–",
        "code RMS of differences, m": f"{rms['code_rms_m']:.2f}" if len(rms) else "–",
        "phase σ of differences, mm": f"{1e3 * rms['phase_sigma_m']:.2f}" if len(rms) else "–",
        "CPU, s": f"{o.cpu_s:.1f}",
    }


def _rms(values: FloatArray) -> str:
    return f"{np.sqrt(np.nanmean(values**2)):.2f}" if len(values) else "–"


def _spread(values: FloatArray) -> str:
    return f"{np.nanmean(values):+.2f} ± {np.nanstd(values):.2f}" if len(values) else "–"


if __name__ == "__main__":
    main()
