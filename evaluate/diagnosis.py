"""Why a recording gives no position: its description put to the test, and others tried.

The satellites themselves are the judges. The cost is bounded: some seconds, and nothing beyond
the first seconds of the recording is read.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import get_args

from deepgnss.core.errors import RecordingError
from deepgnss.core.records import SampleBlock
from deepgnss.evaluate.inspection import inspect
from deepgnss.evaluate.satellites import Reader, convincing, find_satellites, survey
from deepgnss.io.formats import SampleKind, StreamFormat, ValueFormat
from deepgnss.io.recording import Recording
from deepgnss.io.samples import full_scale
from deepgnss.receiver.signals import Signal

_SEARCH_S = 0.021
_INSPECTED_S = 0.1


def diagnose(path: Path, form: StreamFormat, signal: Signal, skip_s: float) -> tuple[str, ...]:
    """What is wrong with the description of a stream, as far as its satellites tell.

    Parameters
    ----------
    path: the recording. form: how the stream is said to lie in it. skip_s: left out at its start.

    Returns nothing when the description fits the satellites found.
    """
    with Recording([form], path) as recording:
        read = reader(recording)
        first = _sample(recording, skip_s)
        count = round(_INSPECTED_S * form.sample_rate_hz)
        rest = recording.streams[0].sample_count - first
        looks = inspect(read(first, min(count, rest)), full_scale(form))
        if looks.values.size == 1:
            return looks.findings
        seen = survey(read, signal, first)
        if convincing(seen.found) or (seen.explained and seen.findings):
            return seen.findings
    for other in _other_formats(form):
        if _shows_satellites(path, other, signal, skip_s):
            text = f"satellites appear when samples are read as {_words(other)}, not {_words(form)}"
            if seen.repeats_hz is not None and seen.repeats_hz > 2.0 * signal.id.chip_rate_hz:
                text += f" (or is the sample rate {seen.repeats_hz:.10g} Hz?)"
            return (text,)
    return (*seen.findings, *looks.findings)


def reader(recording: Recording, place: int = 0) -> Reader:
    """Samples of one stream of a recording by (first, count)."""

    def read(first: int, count: int) -> SampleBlock:
        return recording.read(place, first, count)

    return read


def _sample(recording: Recording, skip_s: float) -> int:
    stream = recording.streams[0]
    return min(round(skip_s * stream.sample_rate_hz), stream.sample_count - 1)


def _other_formats(form: StreamFormat) -> Iterator[StreamFormat]:
    """The same file said to hold other numbers, or real ones instead of complex."""
    formats: tuple[ValueFormat, ...] = get_args(ValueFormat)
    kinds: tuple[SampleKind, ...] = get_args(SampleKind)
    for kind in sorted(kinds, key=lambda kind: kind != form.samples):
        for numbers in formats:
            place_hz = form.intermediate_hz
            if kind == "real" and place_hz == 0.0:  # no real stream has its carrier there
                place_hz = form.sample_rate_hz / 4.0
            try:
                other = replace(form, format=numbers, samples=kind, intermediate_hz=place_hz)
            except RecordingError:  # does not go with the packing described
                continue
            if other != form:
                yield other


def _shows_satellites(path: Path, form: StreamFormat, signal: Signal, skip_s: float) -> bool:
    try:
        with Recording([form], path) as recording:
            first = _sample(recording, skip_s)
            count = min(
                round(_SEARCH_S * form.sample_rate_hz), recording.streams[0].sample_count - first
            )
            return convincing(find_satellites(recording.read(0, first, count), signal))
    except RecordingError:  # the file's size does not go with this format
        return False


def _words(form: StreamFormat) -> str:
    return f"{form.format} {form.samples}"
