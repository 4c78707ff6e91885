"""Read, override, validate and print a configuration: that of a run, or any other schema."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError
from yaml import Node

from deepgnss.core.errors import ConfigError
from deepgnss.io.config.messages import dotted, explain, location_of
from deepgnss.io.config.quantity import Section, Surroundings
from deepgnss.io.config.schema import Config
from deepgnss.io.config.text import Location, line_of, parse, parse_value, write

_Schema = TypeVar("_Schema", bound=Section)


def load_config(
    path: Path | str | None = None, overrides: Sequence[str] = (), *, check_files: bool = True
) -> Config:
    """Read and validate the configuration of a run; see `load`."""
    return load(Config, path, overrides, check_files=check_files)


def load(
    schema: type[_Schema],
    path: Path | str | None = None,
    overrides: Sequence[str] = (),
    *,
    check_files: bool = True,
) -> _Schema:
    """Read a YAML file and hold it to a schema.

    Parameters
    ----------
    path
        YAML file; None: the defaults. Relative paths in it start from its folder (None: from the
        working folder).
    overrides
        Settings "dotted.key=value", applied in order, values as they would stand in the file.
    check_files
        Refuse named input files that do not exist.

    Raises
    ------
    ConfigError
        One line for every key at fault: file and line, key, what was found, what would fit.
    """
    file = Path(path) if path is not None else None
    source = str(file) if file else "settings"
    data, nodes = parse(_read(file), source) if file else ({}, None)
    data = {} if data is None else data
    if not isinstance(data, dict):
        raise ConfigError(f"{source}: expected a mapping (key: value) at the top")
    overridden = [_override(data, setting) for setting in overrides]
    folder = (file.parent if file else Path()).resolve()
    try:
        return schema.model_validate(data, context=Surroundings(folder, check_files))
    except ValidationError as error:
        lines = explain(error, schema, data)
        raise ConfigError(
            "\n".join(
                f"{_origin(source, nodes, location, overridden)}: {line}"
                for location, line in lines.items()
            )
        ) from error


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"{path}: not a YAML text file (byte {error.start} is not UTF-8)"
        ) from error


def _origin(
    source: str, nodes: Node | None, location: Location, overridden: Sequence[Location]
) -> str:
    if any(location[: len(setting)] == setting for setting in overridden):
        return "--set"
    line = line_of(nodes, location)
    return f"{source}:{line}" if line else source


def _override(data: dict[str, Any], setting: str) -> Location:
    """Put one "dotted.key=value" into the data."""
    key, equals, text = setting.partition("=")
    location = location_of(key.strip())
    if not equals or location is None:
        raise ConfigError(f"--set {setting}: expected key=value such as output.interval=0.1")
    value = parse_value(text, f"--set {key}")
    here: Any = data
    for place, part in enumerate(location):
        last = place == len(location) - 1
        if isinstance(part, int):
            # one past the end appends
            if not isinstance(here, list) or part > len(here):
                known = len(here) if isinstance(here, list) else "no"
                raise ConfigError(
                    f"--set {setting}: {dotted(location[:place])} has {known} entries"
                )
            if part == len(here):
                here.append(None)
        elif not isinstance(here, dict):
            raise ConfigError(
                f"--set {setting}: {dotted(location[:place])} is {here!r}, not a mapping"
            )
        if last:
            here[part] = value
        else:
            following = here.get(part) if isinstance(here, dict) else here[part]
            if following is None:
                following = [] if isinstance(location[place + 1], int) else {}
                here[part] = following
            here = following
    return location


def resolved_yaml(config: Section) -> str:
    """Return the whole configuration as YAML, defaults filled in; it reads back as the same."""
    return write(config.model_dump(mode="json", by_alias=True))


def json_schema(schema: type[Section] = Config) -> str:
    """Return the JSON schema of a configuration file."""
    dialect = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return json.dumps(dialect | schema.model_json_schema(), indent=2, ensure_ascii=False) + "\n"
