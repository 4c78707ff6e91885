"""YAML text in and out: YAML 1.2 scalars, safe, duplicate keys refused, line numbers kept.

YAML 1.1, which PyYAML reads, takes `4e6` for text, `010` for 8, `yes` for true and `12:30` for
750; the core schema of YAML 1.2 (section 10.3) does not. Dates stay text; the schema reads them.
"""

from __future__ import annotations

import re
from typing import Any

import yaml

from deepgnss.core.errors import ConfigError

Location = tuple[str | int, ...]
"""Keys and list places from the top of the document down."""


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader with the scalars of YAML 1.2 and without duplicate keys."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012 (none of YAML 1.1's)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _problem("expected text as a key", key)
            if key.value in seen:
                raise _problem(f"key '{key.value}' is given twice", key)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def _problem(text: str, node: yaml.Node) -> yaml.MarkedYAMLError:
    return yaml.constructor.ConstructorError(None, None, text, node.start_mark)


def _whole(loader: _Loader, node: yaml.ScalarNode) -> int:
    text = loader.construct_scalar(node)
    return int(text, 0) if text[:2] in ("0x", "0o") else int(text)


def _number(loader: _Loader, node: yaml.ScalarNode) -> float:
    return float(
        loader.construct_scalar(node).lower().replace(".inf", "inf").replace(".nan", "nan")
    )


_INTEGER = r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+"
_FLOAT = r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"
_NOT_FINITE = r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"

for _tag, _pattern, _first in (
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    ("int", _INTEGER, list("-+0123456789")),
    ("float", f"{_FLOAT}|{_NOT_FINITE}", list("-+.0123456789")),
):
    _Loader.add_implicit_resolver(
        f"tag:yaml.org,2002:{_tag}", re.compile(rf"(?:{_pattern})\Z"), _first
    )
_Loader.add_constructor("tag:yaml.org,2002:int", _whole)
_Loader.add_constructor("tag:yaml.org,2002:float", _number)


def parse(text: str, source: str) -> tuple[Any, yaml.Node | None]:
    """Read a document: its data, and the nodes that know their lines.

    Raises
    ------
    ConfigError
        When the text is not YAML, or gives a key twice; one line with `source` and place.
    """
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        return (loader.construct_document(node) if node else None), node
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f":{mark.line + 1}" if mark else ""
        raise ConfigError(f"{source}{place}: {error.problem or error.context}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        cause = "nested too deeply" if isinstance(error, RecursionError) else str(error)
        raise ConfigError(f"{source}: not YAML text: {' '.join(cause.split())}") from error


def parse_value(text: str, source: str) -> Any:
    """Read the value of a `key=value` setting as it would be read in a file."""
    return parse(text, source)[0]


def line_of(node: yaml.Node | None, location: Location) -> int | None:
    """Line (from 1) of the deepest part of a location that the document has; None: not in it."""
    line = None
    for part in location:
        if isinstance(node, yaml.MappingNode) and isinstance(part, str):
            found = [(key, value) for key, value in node.value if key.value == part]
            if not found:
                break
            key, node = found[0]
            line = key.start_mark.line + 1
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int):
            if part >= len(node.value):
                break
            node = node.value[part]
            line = node.start_mark.line + 1
        else:
            break
    return line


def write(data: Any) -> str:
    """Return YAML text of plain data, in its order, short lists on one line."""
    return yaml.safe_dump(
        data, sort_keys=False, default_flow_style=None, allow_unicode=True, width=100
    )
