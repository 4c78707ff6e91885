"""Ready scenarios: YAML files that ship with the package, called by their names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.resources import as_file, files
from pathlib import Path
from typing import NamedTuple

from deepgnss.core.errors import ConfigError
from deepgnss.io.config import load
from deepgnss.sim.schema.document import ScenarioConfig

PUBLISHED = "reproduce/"
"""Group of the scenarios behind `deepgnss reproduce`."""

_ENDING = ".yaml"


class Ready(NamedTuple):
    """A ready scenario: name, and what its file's first comment says."""

    name: str
    about: str


def ready_scenarios(group: str = "") -> list[Ready]:
    """All ready scenarios of a group by name: "" or PUBLISHED.

    A name begins with its group.
    """
    folder = files("deepgnss.configs") / "scenarios" / group
    found = [entry for entry in folder.iterdir() if entry.name.endswith(_ENDING)]
    return sorted(
        Ready(group + entry.name.removesuffix(_ENDING), _about(entry.read_text("utf-8")))
        for entry in found
    )


def _about(text: str) -> str:
    first = text.split("\n", 1)[0]
    return first.removeprefix("#").strip() if first.startswith("#") else ""


def load_scenario(
    scenario: str | Path, overrides: Sequence[str] = (), *, check_files: bool = True
) -> ScenarioConfig:
    """Read a scenario file, or the ready scenario of this name.

    Raises
    ------
    ConfigError: as of `deepgnss.io.config.load`; or there is neither file nor ready scenario.
    """
    with _file_of(scenario) as path:
        return load(ScenarioConfig, path, overrides, check_files=check_files)


@contextmanager
def _file_of(scenario: str | Path) -> Iterator[Path]:
    names = [ready.name for group in ("", PUBLISHED) for ready in ready_scenarios(group)]
    if str(scenario) in names:
        with as_file(files("deepgnss.configs") / "scenarios" / f"{scenario}{_ENDING}") as path:
            yield path
        return
    path = Path(scenario)
    if not path.suffix and not path.exists():
        raise ConfigError(
            f"{scenario}: neither a file nor a ready scenario; ready: {', '.join(names)}"
        )
    yield path
