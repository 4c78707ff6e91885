"""The whole configuration of a run: the typed schema of the YAML file."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from deepgnss.core.records import SIGNAL_IDS
from deepgnss.io.config.aids import (
    DeepConfig,
    ImuConfig,
    NamedOscillator,
    OdometerConfig,
    TruthConfig,
)
from deepgnss.io.config.ins import InsConfig
from deepgnss.io.config.quantity import AnyPath, ExistingFile, Quantity, Section, Switch, misfit
from deepgnss.io.config.receiver import AcquisitionConfig, PositioningConfig, TrackingConfig
from deepgnss.io.config.recording import RecordingConfig

RoughPosition = tuple[
    Annotated[float, Quantity(-90.0, 90.0, "deg")],
    Annotated[float, Quantity(-180.0, 360.0, "deg")],
    Annotated[float, Quantity(-1000.0, 50_000.0, "m")],
]


def _switch(value: object) -> Any:
    return {"enabled": value} if isinstance(value, bool) else value


class OutputConfig(Section):
    """What is written, where and how often."""

    directory: AnyPath = Field(default="out", validate_default=True)
    """Folder of all outputs; made when absent."""
    interval: Annotated[float, Quantity(0.02, 3600.0, "s")] = 1.0
    """Time between observations and fixes, s; they fall on its integer multiples of GPST."""
    rinex: Switch = True
    """RINEX 3.05 observation and navigation files."""
    nmea: Switch = True
    """NMEA 4.11 sentences."""
    csv: Switch = True
    """CSV of solution, channels and events."""
    report: Switch = True
    """Page (report.html), overview picture and track files (KML, GPX, GeoJSON)."""
    correlations: Switch = False
    """HDF5 of all correlator outputs (large)."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        ms = round(self.interval * 1e3)
        if abs(self.interval * 1e3 - ms) > 1e-6 or 604_800_000 % ms:
            raise misfit(
                "expected whole ms that divide a week, such as 0.02, 0.1, 0.5 or 1 s", "interval"
            )
        return self


class Config(Section):
    """Everything `deepgnss process` can be told."""

    recording: RecordingConfig = RecordingConfig()
    signals: Annotated[
        tuple[Literal["GPS_L1CA", "BDS_B1I"], ...], Field(min_length=1, max_length=2)
    ] = ("GPS_L1CA", "BDS_B1I")
    """Signals to process, where a stream covers them."""
    nav: ExistingFile | None = None
    """Broadcast RINEX NAV file: assisted start."""
    start: Literal["scout", "causal"] = "scout"
    """`scout`: first decode time and ephemerides, then process from the first sample on with them;
    `causal`: as a receiver that was switched on."""
    position: RoughPosition | None = None
    """Rough [latitude deg, longitude deg, height m]: assisted start."""
    imu: ImuConfig | None = None
    ins: InsConfig = InsConfig()
    odometer: OdometerConfig | None = None
    truth: TruthConfig | None = None
    oscillator: NamedOscillator = Field(default="TCXO", validate_default=True)
    """The receiver's oscillator: a name in configs/oscillators, or its h-parameters."""
    deep: Annotated[
        DeepConfig, BeforeValidator(_switch, json_schema_input_type=bool | dict[str, Any])
    ] = DeepConfig()
    """Deep integration: its settings, or just true or false."""
    acquisition: AcquisitionConfig = AcquisitionConfig()
    tracking: TrackingConfig = TrackingConfig()
    positioning: PositioningConfig = PositioningConfig()
    output: OutputConfig = Field(default_factory=dict, validate_default=True)
    threads: Annotated[int, Quantity(1, 1024, "threads", whole=True)] | None = None
    """Threads to compute with; omitted: one per core. The results do not depend on it."""

    def covers(self, signal: str) -> bool:
        """Whether a stream's band holds the signal's carrier."""
        carrier_hz = SIGNAL_IDS[signal].carrier_hz
        return any(
            abs(stream.offset_of(carrier_hz)) <= stream.sample_rate / 2.0
            for stream in self.recording.streams
        )

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if len(set(self.signals)) < len(self.signals):
            raise misfit("expected every signal once", "signals")
        wanted = [SIGNAL_IDS[name] for name in self.signals]
        if self.recording.streams and not any(map(self.covers, self.signals)):
            raise misfit(
                "expected a band with one of "
                + ", ".join(f"{s.name} at {s.carrier_hz / 1e6:.7g} MHz" for s in wanted),
                "recording.streams[0].centre_frequency",
            )
        return self
