"""Guarding a receiver: runs of a suite held against limits and against an earlier summary."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple
from xml.etree import ElementTree

from deepgnss import __version__
from deepgnss.core.errors import DeepGnssError, InputFileError
from deepgnss.evaluate.batch import Drive, Outcome, find_drives, run_drive
from deepgnss.evaluate.metrics import NAMES, Metric, is_worse, metrics
from deepgnss.evaluate.suite import RunConfig, SuiteConfig
from deepgnss.io.input import reading
from deepgnss.io.output import write_whole
from deepgnss.io.summary import write_summary
from deepgnss.sim.output import write_simulation
from deepgnss.sim.schema import build, load_scenario

_CERTAINTY: Final = 2.0  # σ of a change before it counts: both runs bring their noise
_EXACT: Final = 1e-9  # relative; of metrics that have no noise
_UNKNOWN: Final = "not known: too few epochs, or no truth"

Tell = Callable[[str], None]


class Check(NamedTuple):
    """One thing that had to hold."""

    run: str
    what: str
    holds: bool
    found: str


class Report(NamedTuple):
    """All that a suite came to."""

    suite: str
    metrics: Mapping[str, Mapping[str, Metric]]  # by run
    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Whether everything held."""
        return all(check.holds for check in self.checks)


def regress(
    suite: SuiteConfig,
    folder: Path,
    baseline: Mapping[str, Mapping[str, Metric]] | None = None,
    tell: Tell = lambda line: None,
) -> Report:
    """Run a suite; outputs of each run go to a folder of its name.

    Parameters: baseline: metrics of an earlier one, as of `read_summary`.
    """
    found: dict[str, dict[str, Metric]] = {}
    checks: list[Check] = []
    for run in suite.runs:
        tell(run.name)
        try:
            found[run.name] = _measured(run, folder / run.name)
        except DeepGnssError as error:
            checks.append(Check(run.name, "ends with positions", False, str(error)))
            continue
        checks.append(Check(run.name, "ends with positions", True, ""))
        limits = {**suite.limits, **run.limits}
        for name, limit in limits.items():
            value = found[run.name][name].value
            told = _UNKNOWN if math.isnan(value) else f"{value:.6g}"
            checks.append(Check(run.name, f"{name} {limit}", limit.holds(value), told))
        if baseline is not None:
            checks += _against(run.name, found[run.name], baseline.get(run.name, {}))
    return Report(suite.name, found, tuple(checks))


def _measured(run: RunConfig, folder: Path) -> dict[str, Metric]:
    """Metrics of a run: of its recording, or means over the seeds of its scenario."""
    if run.config is not None:
        (drive,) = find_drives([str(run.config)], settings=run.settings)
        return _processed(drive._replace(folder=folder))
    each = []
    for seed in run.seeds:
        with TemporaryDirectory(prefix="deepgnss-") as place:
            drive = _simulated(run, seed, Path(place), folder / f"seed_{seed}")
            each.append(_processed(drive))
    return each[0] if len(each) == 1 else _mean(each)


def _simulated(run: RunConfig, seed: int, place: Path, folder: Path) -> Drive:
    config = load_scenario(run.scenario or "", (*run.scenario_settings, f"seed={seed}"))
    made = write_simulation(build(config), place, os.cpu_count() or 1)
    assisted = (f"nav={place / 'nav.rnx'}",) if run.assisted else ()
    return Drive(run.name, made.config, made.recording, folder, (*assisted, *run.settings), "")


def _processed(drive: Drive) -> dict[str, Metric]:
    outcome: Outcome = run_drive(drive)
    if not outcome.done:
        raise InputFileError(outcome.reason or "no positions")
    return metrics(drive.folder)


def _mean(each: Sequence[Mapping[str, Metric]]) -> dict[str, Metric]:
    """Means over repetitions, their noise from how they scatter."""
    found = {}
    for name in NAMES:
        values = [one[name].value for one in each]
        mean = math.fsum(values) / len(values)
        spread2 = math.fsum((value - mean) ** 2 for value in values) / (len(values) - 1)
        found[name] = Metric(mean, math.sqrt(spread2 / len(values)))
    return found


def _against(run: str, now: Mapping[str, Metric], before: Mapping[str, Metric]) -> list[Check]:
    """What must not have got worse by more than its noise."""
    if not before:
        return [Check(run, "is in the baseline", False, "not there")]
    checks = []
    for name, (value, noise) in now.items():
        if name not in before or math.isnan(before[name].value):
            continue
        was, was_noise = before[name]
        borne = _CERTAINTY * math.hypot(noise, was_noise) + _EXACT * abs(was)
        worse = math.isnan(value) or (is_worse(name, value - was) and abs(value - was) > borne)
        told = _UNKNOWN if math.isnan(value) else f"{value:.6g}"
        found = f"{told}, was {was:.6g} (± {borne:.2g} borne)"
        checks.append(Check(run, f"{name} no worse than before", not worse, found))
    return checks


# --- files -------------------------------------------------------------------------------------


def write_report(report: Report, folder: Path) -> None:
    """junit.xml, summary.md and summary.json (the next baseline) of a suite."""
    write_whole(folder / "junit.xml", junit_xml(report))
    write_whole(folder / "summary.md", markdown(report))
    summary: dict[str, Any] = {
        "deepgnss": __version__,
        "suite": report.suite,
        "passed": report.passed,
        "runs": report.metrics,
        "failed": [check for check in report.checks if not check.holds],
    }
    write_summary(folder / "summary.json", summary)


def read_summary(path: Path) -> dict[str, dict[str, Metric]]:
    """Metrics by run of an earlier suite's summary.json.

    Raises InputFileError: the file cannot be read, or is none.
    """
    with reading(path):
        text = path.read_text(encoding="utf-8")
    try:
        return {
            str(run): {
                str(name): Metric(_number(metric["value"]), _number(metric["noise"]))
                for name, metric in of_run.items()
            }
            for run, of_run in json.loads(text)["runs"].items()
        }
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputFileError(f"{path}: not the summary.json of a suite") from error


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def junit_xml(report: Report) -> str:
    """JUnit XML: a test suite per run, a test case per check."""
    root = ElementTree.Element("testsuites", name=report.suite)
    for run in dict.fromkeys(check.run for check in report.checks):
        checks = [check for check in report.checks if check.run == run]
        failed = sum(not check.holds for check in checks)
        suite = ElementTree.SubElement(
            root, "testsuite", name=run, tests=str(len(checks)), failures=str(failed), errors="0"
        )
        for check in checks:
            case = ElementTree.SubElement(
                suite, "testcase", classname=f"{report.suite}.{run}", name=check.what
            )
            if not check.holds:
                ElementTree.SubElement(case, "failure", message=check.found)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def markdown(report: Report) -> str:
    """Summary for people: what failed first, then the metrics of every run."""
    failed = [check for check in report.checks if not check.holds]
    verdict = f"{len(failed)} of {len(report.checks)} failed" if failed else "everything holds"
    lines = [f"# {report.suite}: {verdict}", ""]
    if failed:
        lines += ["| run | expected | found |", "|---|---|---|"]
        lines += [f"| {c.run} | {c.what} | {c.found} |" for c in failed] + [""]
    runs = list(report.metrics)
    lines += ["| metric | " + " | ".join(runs) + " |", "|---" * (len(runs) + 1) + "|"]
    for name in NAMES:
        cells = [_cell(report.metrics[run][name]) for run in runs]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _cell(metric: Metric) -> str:
    if math.isnan(metric.value):
        return "–"
    return f"{metric.value:.4g}" + (f" ± {metric.noise:.2g}" if metric.noise > 0.0 else "")
