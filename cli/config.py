"""`deepgnss config`: check, show or explain a configuration."""

from __future__ import annotations

from pathlib import Path

import click

from deepgnss.io.config import (
    json_schema,
    load_config,
    notes,
    reference_markdown,
    resolved_yaml,
)


@click.command()
@click.argument("file", required=False, type=click.Path(path_type=Path))
@click.option("--check", "action", flag_value="check", default=True, help="Validate (default).")
@click.option("--show", "action", flag_value="show", help="Print it with all defaults, as YAML.")
@click.option("--schema", "action", flag_value="schema", help="Print the JSON schema.")
@click.option(
    "--reference", "action", flag_value="reference", help="Print all keys explained, as Markdown."
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="KEY=VALUE",
    help="Change a key, e.g. tracking.carrier.bandwidth=5 (repeatable).",
)
def config(file: Path | None, action: str, settings: tuple[str, ...]) -> None:
    """Check, show or explain a configuration FILE (without one: the defaults)."""
    if action == "schema":
        click.echo(json_schema(), nl=False)
        return
    if action == "reference":
        click.echo(reference_markdown(), nl=False)
        return
    loaded = load_config(file, settings, check_files=action == "check")
    for line in notes(loaded):
        click.echo(f"note: {line}", err=True)
    if action == "show":
        click.echo(resolved_yaml(loaded), nl=False)
    else:
        click.echo(f"{file or 'defaults'}: valid")
