"""Error models that ship with the package, one YAML file each, and their names."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

from deepgnss.io.config.quantity import misfit
from deepgnss.io.config.text import parse_value


def shipped_names(kind: str) -> list[str]:
    """Names of the files in a folder of configs, such as "oscillators"."""
    folder = files("deepgnss.configs") / kind
    return sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".yaml"))


def by_name(kind: str, value: object, otherwise: str) -> Any:
    """A name replaced by what its file holds; anything else as it is.

    otherwise: what may stand there instead of a name.
    """
    if not isinstance(value, str):
        return value
    names = shipped_names(kind)
    if value not in names:
        raise misfit(f"expected one of {', '.join(names)}, or {otherwise}")
    text = (files("deepgnss.configs") / kind / f"{value}.yaml").read_text("utf-8")
    return {"name": value} | dict(parse_value(text, f"{value}.yaml"))
