"""What a configuration asks for and this version does not do: said, never silent."""

from __future__ import annotations

from deepgnss.io.config.schema import Config


def notes(config: Config) -> tuple[str, ...]:
    """Lines to print before a run: the parts of the configuration that will have no effect."""
    lines = []
    asked = "signals" in config.model_fields_set
    for signal in config.signals:
        if config.recording.streams and not config.covers(signal) and asked:
            lines.append(f"signals: {signal} lies outside of every stream")
    if config.odometer is not None and (config.imu is None or config.ins.vehicle is None):
        lines.append("odometer: not used without `imu` and `ins.vehicle`")
    if config.imu is not None and config.deep.enabled and config.deep.coupling == "tight":
        lines.append("deep.coupling: tight: not in this version, which couples loosely")
    return tuple(lines)
