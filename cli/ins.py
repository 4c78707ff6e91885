"""`deepgnss ins`: an inertial log and a GNSS solution in; trajectory, biases, innovations out."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from deepgnss.cli.main import EXIT_NOTHING_USABLE
from deepgnss.core.errors import ConfigError
from deepgnss.deep.loose import LooseRun, Outage, read_inputs, run_loose
from deepgnss.deep.loose_outputs import FILES, write_run
from deepgnss.evaluate.inertial import (
    InertialErrors,
    OutageError,
    consistency,
    inertial_errors,
    outage_errors,
    write_inertial_errors,
    write_outages,
)
from deepgnss.evaluate.inertial_figure import draw_inertial
from deepgnss.ins.updates import counts
from deepgnss.io.config import Config, load_config
from deepgnss.io.folder import prepare_folder, written
from deepgnss.io.truth import Trajectory, read_truth

_NARROWEST = 100  # columns of the tables where there is no terminal


class _OutageType(click.ParamType[Outage]):
    """FROM:SECONDS."""

    name = "FROM:SECONDS"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> Outage:
        try:
            from_s, length_s = (float(part) for part in str(value).split(":"))
        except ValueError:
            self.fail(f"{value!r}: expected FROM:SECONDS such as 120:30", param, ctx)
        if not (np.isfinite(from_s) and 0.0 < length_s < np.inf):
            self.fail(f"{value!r}: expected a length above 0 s", param, ctx)
        return Outage(from_s, length_s)


@click.command()
@click.option("--imu", type=click.Path(path_type=Path), help="Log; instead of the config's.")
@click.option(
    "--gnss",
    type=click.Path(path_type=Path),
    required=True,
    help="solution.csv, RTKLIB .pos, or KF-GINS text.",
)
@click.option("--config", "config_path", type=click.Path(path_type=Path), help="YAML file.")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Override a key.")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Folder of the outputs.")
@click.option(
    "--withhold",
    "outages",
    type=_OutageType(),
    multiple=True,
    help="Keep fixes from the filter, s since the first, to judge it by (repeatable).",
)
def ins(
    imu: Path | None,
    gnss: Path,
    config_path: Path | None,
    overrides: tuple[str, ...],
    output: Path | None,
    outages: tuple[Outage, ...],
) -> None:
    """Loose coupling of an inertial log and a GNSS solution, with RTS smoothing.

    The section `imu` of the config describes the log, `ins` the filter; `odometer` and `truth`
    are used where they are given. Exit codes as those of `process`; 1: never aligned.
    """
    if imu is not None:
        overrides = (f"imu.file={imu.resolve()}", *overrides)
    if output is not None:
        overrides = (*overrides, f"output.directory={output.resolve()}")
    config = load_config(config_path, overrides)
    folder, screen = config.output.directory, Console(stderr=True)
    truth = _truth(config)
    inputs = read_inputs(config, gnss)
    for line in inputs.warnings:
        screen.print(f"warning: {line}", markup=False, highlight=False, soft_wrap=True)
    prepare_folder(folder, FILES)
    run = run_loose(config, inputs, outages)
    for event in run.integration.events:
        since_s = event.time_s - inputs.fixes[0].time.since(inputs.block.origin)
        line = f"{since_s:9.2f} s  {event.what}: {event.reason}"
        screen.print(line, markup=False, highlight=False, soft_wrap=True)
    if not run.integration.epochs:
        reason = f"error: no alignment: {run.integration.reason}"
        screen.print(reason, markup=False, highlight=False, soft_wrap=True)
        raise click.exceptions.Exit(EXIT_NOTHING_USABLE)
    write_run(folder, run)
    errors = None if truth is None else inertial_errors(run.forward, truth)
    if errors is not None:
        write_inertial_errors(folder / "errors.csv", errors)
    found = outage_errors(run, truth)
    if found:
        write_outages(folder / "outages.csv", found)
    if config.output.report:
        draw_inertial(folder / "inertial.png", run, errors)
    console = Console()
    if not console.is_terminal:
        console.width = max(console.width, _NARROWEST)
    if found:
        console.print(_outage_table(outages, found))
    if errors is not None and truth is not None:
        smooth = inertial_errors(run.smooth, truth) if run.smooth is not None else None
        console.print(_error_table(errors, smooth))
    console.print(_summary(run, folder))


def _truth(config: Config) -> Trajectory | None:
    if config.truth is None:
        return None
    lever = config.imu.lever_arm if config.imu is not None else None
    if config.truth.format == "kfgins_nav" and lever is None:
        raise ConfigError("imu.lever_arm: a truth of the IMU needs it")
    return read_truth(config.truth.file, config.truth.format, lever_arm_m=lever)


# --- what the screen shows -----------------------------------------------------------------------


def _table(*names: str) -> Table:
    table = Table(box=None, padding=(0, 2), title_justify="left")
    for k, name in enumerate(names):
        table.add_column(name, justify="right" if k else "left", no_wrap=True)
    return table


def _outage_table(outages: tuple[Outage, ...], found: tuple[OutageError | None, ...]) -> Table:
    table = _table("withheld", "s", "north m", "east m", "down m", "horizontal m", "1σ m", "NEES/3")
    for outage, error in zip(outages, found, strict=True):
        label = f"{outage.from_s:g} s"
        if error is None:
            table.add_row(label, f"{outage.length_s:g}", *["no navigation there"])
            continue
        table.add_row(
            label,
            f"{outage.length_s:g}",
            *(f"{x:+.2f}" for x in error.error_n_m),
            f"{error.horizontal_m:.2f}",
            f"{error.horizontal_sigma_m:.2f}",
            f"{error.nees:.2f}",
        )
    return table


def _error_table(forward: InertialErrors, smooth: InertialErrors | None) -> Table:
    table = _table("errors, RMS", "", "north", "east", "down", "NEES/3", "within 3σ")
    for name, errors in (("forward", forward), ("smoothed", smooth)):
        for part in consistency(errors) if errors is not None else ():
            turned = part.quantity == "attitude"
            unit = {"position": "m", "velocity": "m/s", "attitude": "deg"}[part.quantity]
            rms = np.degrees(part.rms) if turned else part.rms
            table.add_row(
                f"{name} {part.quantity}",
                unit,
                *(f"{x:.3f}" for x in rms),
                f"{part.nees:.2f}",
                f"{100.0 * part.within:.1f} %",
            )
    return table


def _summary(run: LooseRun, folder: Path) -> Table:
    table = Table.grid(padding=(0, 2))
    epochs, integration = run.forward, run.integration
    table.add_row("navigated", f"{_navigated_s(run):.1f} s, {epochs.time_s.size} epochs")
    starts = sum(not epoch.continues for epoch in integration.epochs)
    bridged = [event for event in integration.events if event.what == "bridged"]
    table.add_row("starts", f"{starts}")
    table.add_row("gaps bridged", f"{len(bridged)}")
    for kind, count in counts(integration.innovations).items():
        table.add_row(f"{kind}", f"{count.tested} tested, {count.rejected} refused")
    sigma = np.sqrt(np.diagonal(epochs.covariance[-1]))
    table.add_row("last 1σ, horizontal", f"{float(np.hypot(*sigma[:2])):.3f} m")
    table.add_row("last 1σ, heading", f"{np.degrees(sigma[8]):.3f} deg")
    if integration.reason:
        table.add_row("ended early", integration.reason)
    table.add_row("written to", str(folder))
    table.add_row("", ", ".join(path.name for path in written(folder, FILES)))
    return table


def _navigated_s(run: LooseRun) -> float:
    continues = np.array([epoch.continues for epoch in run.integration.epochs[1:]], dtype=np.bool_)
    return float(np.diff(run.forward.time_s)[continues].sum())
