"""Whom to look for, when and where: predictions against the simulator, cost bounded."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from simulated_sky import shared_sky

from deepgnss.core.records import NavData, RunningSums
from deepgnss.receiver import search as module
from deepgnss.receiver.acquisition import Acquisition, AcquisitionSettings, SearchWindow
from deepgnss.receiver.baseband import running_sums
from deepgnss.receiver.search import (
    Assistance,
    Place,
    Searcher,
    SearchSettings,
    aim_of,
    predict_sights,
    window_of,
)
from deepgnss.receiver.signals import GPS_L1CA_SIGNAL, Signal
from deepgnss.receiver.weak_search import WeakSettings, weak_search

RATE_HZ = 2.6e6
EPOCH = int(0.1 * RATE_HZ)


def _place(sample: int) -> Place:
    """The truth of the shared sky at a sample."""
    sky = shared_sky()
    read_s = sample / sky.rate_hz
    error_s = sky.scenario.clock.offset_s + sky.scenario.clock.drift_sps * read_s
    motion = sky.scenario.vehicle.point(np.array([read_s - error_s]))
    return Place(
        sky.scenario.start.plus(read_s - error_s),
        motion.r_m[0],
        motion.v_mps[0],
        sky.scenario.clock.drift_sps,
    )


@pytest.mark.parametrize("sample", [0, 1_300_000, 20_000_000])
def test_predictions_are_what_the_samples_hold(sample: int) -> None:
    """Doppler to half a hertz, code phase to a tenth of a chip (the atmosphere is left out)."""
    sky, place = shared_sky(), _place(sample)
    sights = {s.satellite: s for s in predict_sights(place, sky.scenario.nav, GPS_L1CA_SIGNAL)}
    assert len(sights) == 30
    for emitter in sky.scenario.emitters:
        sight = sights[emitter.satellite]
        truth = sky.truth(emitter.satellite, np.array([sample - 1300, sample, sample + 1300]))
        doppler_hz = (truth.carrier_cycles[2] - truth.carrier_cycles[0]) * 1e3
        assert sight.doppler_hz == pytest.approx(doppler_hz, abs=0.5)
        window = window_of(sight, place, GPS_L1CA_SIGNAL, SearchSettings())
        off = (window.code_chips - truth.code_chips[1] + 511.5) % 1023.0 - 511.5
        assert abs(off) < 0.1
        assert window.doppler_hz == sight.doppler_hz
        assert sight.healthy
        assert sight.elevation_rad > np.radians(5.0)


def test_a_place_of_another_time_gives_wider_windows() -> None:
    """A scout pass ends elsewhere, at a speed that says nothing of the beginning."""
    place, settings = _place(0), SearchSettings()
    sight = predict_sights(place, shared_sky().scenario.nav, GPS_L1CA_SIGNAL)[0]
    narrow = window_of(sight, place, GPS_L1CA_SIGNAL, settings)
    wide = window_of(sight, place._replace(moving=True), GPS_L1CA_SIGNAL, settings)
    assert wide[0] == narrow[0]
    assert wide.code_chips == narrow.code_chips
    assert wide.doppler_half_hz - narrow.doppler_half_hz > 250.0 / 0.1903
    metres = (wide.code_half_chips - narrow.code_half_chips) * 293.05
    assert metres == pytest.approx(settings.moved_m, rel=1e-3)


def test_a_long_search_where_predicted_sees_the_whole_strength() -> None:
    """Wrong symbol edges would cost 1 dB or more, a wrong place everything."""
    sky, sample = shared_sky(), 3_900_000
    place = _place(sample)
    sights = {s.satellite: s for s in predict_sights(place, sky.scenario.nav, GPS_L1CA_SIGNAL)}
    settings = WeakSettings(0.4)

    def read(first: int, count: int) -> RunningSums:
        return running_sums(sky.read("L1", first, count), GPS_L1CA_SIGNAL.id.carrier_hz)

    for emitter in sky.scenario.emitters:
        aim = aim_of(sights[emitter.satellite], place, GPS_L1CA_SIGNAL, SearchSettings())
        seen = weak_search(read, sample, GPS_L1CA_SIGNAL, emitter.prn, aim, settings, sky.rate_hz)
        assert seen.found
        assert seen.cn0_dbhz == pytest.approx(emitter.cn0_at(1.4), abs=0.6)
        off = (seen.code_chips - aim.window.code_chips + 511.5) % 1023.0 - 511.5
        assert abs(off) < 0.15
        assert abs(seen.doppler_hz - aim.window.doppler_hz) < 4.0


def test_sick_satellites_are_told_and_other_systems_left_out() -> None:
    nav = shared_sky().scenario.nav
    sick = tuple(replace(e, health=63) for e in nav.ephemerides["G05"])
    beidou = tuple(replace(e, satellite="C05") for e in nav.ephemerides["G06"])
    nav = replace(nav, ephemerides={**nav.ephemerides, "G05": sick, "C05": beidou})
    sights = predict_sights(_place(0), nav, GPS_L1CA_SIGNAL)
    assert [s.satellite for s in sights if not s.healthy] == ["G05"]
    assert {s.satellite[0] for s in sights} == {"G"}
    assert predict_sights(_place(0), NavData(), GPS_L1CA_SIGNAL) == []


# --- when ----------------------------------------------------------------------------------------


class _Feed:
    """Counts how often samples are asked for."""

    asked = 0

    def over(self, first: int, count: int) -> None:
        self.asked += 1


@pytest.fixture
def weak() -> list[tuple[int, int]]:
    """(sample it goes back from, PRN) of every long search."""
    return []


@pytest.fixture
def searched(
    monkeypatch: pytest.MonkeyPatch, weak: list[tuple[int, int]]
) -> list[tuple[int, int, bool]]:
    """(first sample, PRN, in a window) of every search; none finds anything."""
    log: list[tuple[int, int, bool]] = []

    def one(
        sums: None,
        first: int,
        signal: Signal,
        prn: int,
        settings: AcquisitionSettings,
        window: SearchWindow | None = None,
        executor: None = None,
    ) -> Acquisition:
        log.append((first, prn, window is not None))
        return Acquisition(f"G{prn:02d}", prn, first, 0.0, 0.0, 1.0, 8.0, 0.0, False, "noise")

    def many(
        sums: None,
        first: int,
        signal: Signal,
        settings: AcquisitionSettings,
        prns: Any,
        *rest: Any,
    ) -> list[Acquisition]:
        return [one(sums, first, signal, prn, settings) for prn in prns]

    def windows(
        sums: None,
        first: int,
        signal: Signal,
        wanted: dict[int, SearchWindow],
        settings: AcquisitionSettings,
        *rest: Any,
    ) -> list[Acquisition]:
        return [one(sums, first, signal, prn, settings, wanted[prn]) for prn in wanted]

    def long(read: Any, now: int, signal: Signal, prn: int, *rest: Any) -> Acquisition:
        weak.append((now, prn))
        return Acquisition(f"G{prn:02d}", prn, now, 0.0, 0.0, 1.0, 8.0, 0.0, False, "noise")

    monkeypatch.setattr(module, "weak_search", long)
    monkeypatch.setattr(module, "search", one)
    monkeypatch.setattr(module, "cold_search", many)
    monkeypatch.setattr(module, "search_windows", windows)
    return log


def _run(
    searcher: Searcher, seconds: float, place: Place | None, nav: NavData, tracked: frozenset[int]
) -> _Feed:
    feed = _Feed()
    for first in range(0, int(seconds * RATE_HZ), EPOCH):
        searcher.look(feed, first, first + EPOCH, Assistance(nav, place), tracked, 0, None)  # type: ignore[arg-type]
    return feed


def _searcher(settings: SearchSettings = SearchSettings()) -> Searcher:  # noqa: B008
    return Searcher(GPS_L1CA_SIGNAL, AcquisitionSettings(), settings, RATE_HZ)


def test_knowing_nothing_all_are_searched_first_then_one_after_the_other(
    searched: list[tuple[int, int, bool]],
) -> None:
    tracked = frozenset({3, 7})
    _run(_searcher(), 70.0, None, NavData(), tracked)
    first = [prn for sample, prn, _ in searched if sample == 0]
    assert first == [prn for prn in range(1, 33) if prn not in tracked]
    later = [(sample, prn) for sample, prn, _ in searched if sample > 0]
    np.testing.assert_allclose(np.diff([s for s, _ in later]) / RATE_HZ, 2.0, atol=0.11)
    assert [prn for _, prn in later[:30]] == first  # all in turn
    assert later[30][1] == 1


@pytest.mark.parametrize(("present", "again"), [(4, False), (3, True)])
def test_at_first_those_far_below_the_horizon_are_searched_only_where_others_are_too_few(
    monkeypatch: pytest.MonkeyPatch, present: int, again: bool
) -> None:
    """By a place and a time good to minutes; of those without orbits nothing is known."""
    asked: list[list[int]] = []

    def many(
        sums: None, first: int, signal: Signal, settings: None, prns: list[int], *rest: Any
    ) -> list[Acquisition]:
        asked.append(prns)
        return [
            Acquisition(f"G{prn:02d}", prn, first, 0.0, 0.0, 9.0, 8.0, 45.0, k < present)
            for k, prn in enumerate(prns)
        ]

    monkeypatch.setattr(module, "cold_search", many)
    nav, rough = shared_sky().scenario.nav, _place(0)
    rough = rough._replace(time=rough.time.plus(300.0))
    hidden = {
        int(s.satellite[1:])
        for s in predict_sights(rough, nav, GPS_L1CA_SIGNAL)
        if s.elevation_rad < np.radians(-10.0)
    }
    assert 8 < len(hidden) < 20
    shown = [prn for prn in range(1, 33) if prn not in hidden]
    known = Assistance(nav, None, rough)
    found = _searcher().look(_Feed(), 0, EPOCH, known, frozenset(), 0, None)  # type: ignore[arg-type]
    assert asked == [shown, list(range(1, 33))] if again else [shown]
    assert [outcome.seen.prn for outcome in found] == asked[-1]
    # Those tracked on other signals count.
    asked.clear()
    _searcher().look(_Feed(), 0, EPOCH, known, frozenset(), 1, None)  # type: ignore[arg-type]
    assert asked == [shown]


def test_predicted_ones_only_and_ever_less_often(searched: list[tuple[int, int, bool]]) -> None:
    """In narrow windows; nobody below the horizon; a bounded number a minute."""
    nav, place = shared_sky().scenario.nav, _place(0)
    visible = {
        int(s.satellite[1:])
        for s in predict_sights(place, nav, GPS_L1CA_SIGNAL)
        if s.elevation_rad > np.radians(3.0)
    }
    tracked = frozenset(sorted(visible)[:4])
    feed = _run(_searcher(), 60.0, place, nav, tracked)
    in_window = [(sample, prn) for sample, prn, window in searched if window]
    assert {prn for _, prn in in_window} == visible - tracked
    times_s = np.array([s for s, prn in in_window if prn == min(visible - tracked)]) / RATE_HZ
    assert times_s[0] == 0.0
    gaps_s = np.diff(times_s)
    assert np.all(np.diff(gaps_s) >= -0.11)
    assert 7.8 < gaps_s[-1] < 9.1
    blind = [prn for _, prn, window in searched if not window]
    assert set(blind) <= {31, 32}  # the constellation has thirty
    assert len(blind) <= 7
    assert feed.asked < 40


def test_a_lost_satellite_is_looked_for_at_once(searched: list[tuple[int, int, bool]]) -> None:
    nav, place = shared_sky().scenario.nav, _place(0)
    searcher = _searcher()
    _run(searcher, 30.0, place, nav, frozenset())
    prn = next(prn for _, prn, window in searched if window)
    searched.clear()
    searcher.lost(prn)
    start = int(31.0 * RATE_HZ)
    for first in range(start, start + 11 * EPOCH, EPOCH):
        searcher.look(_Feed(), first, first + EPOCH, Assistance(nav, place), frozenset(), 0, None)  # type: ignore[arg-type]
    assert prn in [p for _, p, window in searched if window]


def test_no_search_beyond_the_epoch(searched: list[tuple[int, int, bool]]) -> None:
    """What the recording's end leaves is too short."""
    feed = _Feed()
    assert not _searcher().look(feed, 0, 1000, Assistance(NavData()), frozenset(), 0, None)  # type: ignore[arg-type]
    assert not searched
    assert feed.asked == 0


# --- weak ones -----------------------------------------------------------------------------------


def test_those_a_usual_search_missed_are_searched_for_long_at_a_bounded_pace(
    searched: list[tuple[int, int, bool]], weak: list[tuple[int, int]]
) -> None:
    """One every few seconds, all in turn, none before there is a past to look back on."""
    nav, place = shared_sky().scenario.nav, _place(0)
    _run(_searcher(), 120.0, place, nav, frozenset())
    missed = {prn for _, prn, window in searched if window}
    assert {prn for _, prn in weak} == missed
    times_s = np.array([sample for sample, _ in weak]) / RATE_HZ
    assert 1.0 < times_s[0] < 1.3
    np.testing.assert_allclose(np.diff(times_s), 5.0, atol=0.11)
    turns = [prn for _, prn in weak]
    assert len(set(turns[: len(missed)])) == len(missed)
    tracked = frozenset(missed)
    weak.clear()
    _run(_searcher(), 20.0, place, nav, tracked)
    assert not weak
    _run(_searcher(SearchSettings(weak=None)), 20.0, place, nav, frozenset())
    assert not weak


def test_blind_searches_are_longer_while_few_are_tracked_and_look_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[tuple[int, int, int]] = []

    def one(
        sums: None,
        first: int,
        signal: Signal,
        prn: int,
        settings: AcquisitionSettings,
        executor: None,
    ) -> Acquisition:
        asked.append((first, prn, settings.noncoherent))
        return Acquisition(f"G{prn:02d}", prn, first, 1000.0, 3.0, 9.0, 8.0, 30.0, True)

    monkeypatch.setattr(module, "search", one)
    monkeypatch.setattr(module, "cold_search", lambda *rest: [])
    for tracked, elsewhere, sums in (
        (frozenset({1}), 0, 8),
        (frozenset({1}), 3, 2),
        (frozenset({1, 2, 3, 4}), 0, 2),
    ):
        searcher = _searcher()
        asked.clear()
        found = []
        for first in range(0, int(2.2 * RATE_HZ), EPOCH):
            found += searcher.look(
                _Feed(),  # type: ignore[arg-type]
                first,
                first + EPOCH,
                Assistance(NavData()),
                tracked,
                elsewhere,
                None,
            )
        ((begin, _, noncoherent),) = asked
        assert noncoherent == sums
        now = 20 * EPOCH
        assert begin == (
            now - round(0.082 * RATE_HZ) if sums == 8 else now - round(0.022 * RATE_HZ)
        )
        # The code went on meanwhile.
        chips = 3.0 + (now - begin) / RATE_HZ * 1.023e6 * (1.0 + 1000.0 / 1575.42e6)
        assert found[0].seen.first == now
        assert found[0].seen.code_chips == pytest.approx(chips % 1023.0, abs=1e-6)
