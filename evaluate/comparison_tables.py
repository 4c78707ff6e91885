"""Tables of a comparison as text, for the screen and for the page alike; T 6.10–6.17."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Final, NamedTuple

import pandas as pd

from deepgnss.evaluate.comparison import Comparison, Ways
from deepgnss.evaluate.double_differences import usual_sigma
from deepgnss.evaluate.outages import GOOD_M, Gap, Recovery
from deepgnss.evaluate.rtk import RATIO, Fixes

_MOST_GAPS: Final = 20


class Sheet(NamedTuple):
    """A table of text."""

    title: str
    head: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    note: str = ""
    words: int = 1  # columns from the left that hold words; the others hold numbers


def sheets(found: Comparison) -> Iterator[Sheet]:
    """All there is to tell."""
    if found.origins:
        yield _origins(found)
    if found.positions:
        yield _positions(found)
    if found.sections:
        yield _sections(found)
    if found.ways is not None and found.errors:
        yield from _gaps(found.ways)
    if found.heard:
        yield _heard(found)
    for name, table in found.observations.items():
        yield _differences(name, table)
    if found.clocks:
        yield _clocks(found)
    if found.rtk.shares:
        yield _fixes(found.rtk)


def _origins(found: Comparison) -> Sheet:
    head = ("receiver", "file", "positions", "of the", "times in it")
    rows = [(name, o.kind, o.positions, o.point, o.time) for name, o in found.origins.items()]
    return Sheet("Receivers", head, rows, "all compared on GPST", len(head))


def _positions(found: Comparison) -> Sheet:
    head = ("receiver", "fixed", "σ N", "σ E", "σ D", "RMS", "CEP50", "CEP95", "gross")
    rows = []
    for name, one in found.positions.items():
        metres = (one.north_std_m, one.east_std_m, one.down_std_m, one.horizontal_rms_m)
        rows.append(
            (
                name,
                f"{100.0 * one.fixed_share:.1f} % of {one.epochs}",
                *(_metres(x) for x in (*metres, one.cep50_m, one.cep95_m)),
                _percent(one.gross_share, 2),
            )
        )
    compared = next(iter(found.positions.values())).compared
    note = f"errors over the {compared} instants at which all have one"
    return Sheet("Positions against truth", head, rows, note)


def _sections(found: Comparison) -> Sheet:
    names = tuple(next(iter(found.sections.values())))
    rows = [
        (section, *(_percent(share) for share in shares.values()))
        for section, shares in found.sections.items()
    ]
    return Sheet("Share of instants with a position", ("section", *names), rows)


def _gaps(ways: Ways) -> Iterator[Sheet]:
    names = tuple(ways.own_gaps)
    if ways.gaps:
        named = bool(ways.gaps[0][0].name)
        rows = [
            (
                gap.name or _clock(gap.start, ways),
                f"{ways.interval_s * (gap.end - gap.start):g} s",
                *(f"{_after(told[name].first_s)}, {_after(told[name].good_s)}" for name in names),
            )
            for gap, told in _longest(ways)
        ]
        left = len(ways.gaps) - len(rows)
        yield Sheet(
            "Back after the gaps named" if named else "Back after gaps that all had",
            ("gap", "lasted", *names),
            rows,
            f"from the end of the gap to the first position, and to the first within {GOOD_M:g} m"
            + ("" if named else "; it ends when the first receiver has a position")
            + (f"; {left} shorter ones left out" if left else ""),
        )
    rows = [
        (
            name,
            str(own.gaps),
            f"{own.total_s:g} s",
            f"{own.longest_s:g} s",
            *(_after(x) if own.gaps else "–" for x in (own.good_median_s, own.good_worst_s)),
        )
        for name, own in ways.own_gaps.items()
    ]
    yield Sheet(
        "Gaps of each receiver",
        ("receiver", "gaps", "together", "longest", "then good, median", "worst"),
        rows,
        f"between its first and last position; good: within {GOOD_M:g} m, after the gap's end",
    )


def _longest(ways: Ways) -> list[tuple[Gap, Mapping[str, Recovery]]]:
    ranked = sorted(ways.gaps, key=lambda one: one[0].start - one[0].end)[:_MOST_GAPS]
    return sorted(ranked, key=lambda one: one[0].start)


def _heard(found: Comparison) -> Sheet:
    rows = [
        (
            name,
            str(one.epochs),
            f"{one.ranges:.2f}",
            f"{one.phases:.2f}",
            "–" if math.isnan(one.cn0_dbhz) else f"{one.cn0_dbhz:.1f} dB-Hz",
            str(one.slips),
        )
        for name, one in found.heard.items()
    ]
    head = ("receiver", "epochs", "ranges/epoch", "phases/epoch", "C/N0", "slips told")
    note = "GPS L1 C/A and BeiDou B1I, while all were running; each at its own epochs"
    return Sheet("Observed", head, rows, note)


def _differences(name: str, found: pd.DataFrame) -> Sheet:
    head = (
        "satellite",
        "against",
        "epochs",
        "code σ",
        "code mean",
        "phase σ",
        "phase max",
        "slips",
    )
    rows = [
        (
            str(satellite),
            str(row["reference"]),
            str(int(row["epochs"])),
            f"{row['code_sigma_m']:.3f} m",
            f"{row['code_mean_m']:+.3f} m",
            f"{100.0 * row['phase_sigma_m']:.3f} cm",
            f"{100.0 * row['phase_max_m']:.3f} cm",
            str(int(row["slips"])),
        )
        for satellite, row in found.iterrows()
    ]
    note = ""
    if len(found):
        code_m, phase_m = usual_sigma(found, "code_sigma_m"), usual_sigma(found, "phase_sigma_m")
        note = f"together: code {code_m:.3f} m, phase {100.0 * phase_m:.3f} cm"
        note += f", {int(found['slips'].sum())} slips"
    return Sheet(f"{name}: double differences", head, rows, note, 2)


def _clocks(found: Comparison) -> Sheet:
    rows = [
        (name, f"{clock.median_m:+.3f} m", f"{clock.sigma_m:.3f} m", str(clock.differences))
        for name, clock in found.clocks.items()
    ]
    head = ("receiver", "median", "σ of one", "differences")
    return Sheet("Clock against the base (delays of cables in it)", head, rows)


def _fixes(rtk: Fixes) -> Sheet:
    rows = []
    for name, one in rtk.shares.items():
        counts = (one.right, one.wrong, one.floating, one.without)
        told = (f"{count} ({_percent(count / max(one.epochs, 1))})" for count in counts)
        rms = "–" if math.isnan(one.right_rms_m) else f"{100.0 * one.right_rms_m:.2f} cm"
        rows.append((name, str(one.epochs), *told, rms))
    head = ("receiver", "instants", "right", "wrong", "float", "without", "RMS of the right")
    return Sheet("RTK by RTKLIB", head, rows, f"fixed: ratio above {RATIO:g}")


def _metres(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.2f} m"


def _percent(share: float, digits: int = 1) -> str:
    return "–" if math.isnan(share) else f"{100.0 * share:.{digits}f} %"


def _after(time_s: float) -> str:
    return f"{time_s:g} s" if math.isfinite(time_s) else "not"


def _clock(instant: int, ways: Ways) -> str:
    return f"at {(instant - int(ways.asked[0])) * ways.interval_s:g} s"
