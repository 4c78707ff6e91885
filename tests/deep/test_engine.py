"""The whole receiver on a simulated sky: when it knows what, how well, and what counts not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from simulated_sky import (
    BLOCKED_1_S,
    BLOCKED_5_S,
    CARRIER_HZ,
    STEADY_DBHZ,
    Sky,
    make_sky,
    shared_sky,
)

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import (
    FloatArray,
    NavData,
    Observation,
    SampleBlock,
)
from deepgnss.deep.engine import Engine, ScoutPass, workers
from deepgnss.deep.setup import Covered, RunPlan, receiver_settings
from deepgnss.io.config import Config
from deepgnss.receiver.clock import NS, to_ns
from deepgnss.receiver.receiver import Fix, Knowledge, StepResult
from deepgnss.receiver.signals import GPS_L1CA_SIGNAL
from deepgnss.sim.motion.paths import Line
from deepgnss.sim.motion.profile import smooth_profile

SHORT_S = 5.7  # the first fixes are in it
SUBFRAME_AT_S = 4.0  # the first whole one of the shared sky starts here


def _plan(sky: Sky, end_s: float, *, nav: bool = True, threads: int = 1) -> RunPlan:
    config = Config.model_validate({"output": {"interval": 0.1}, "signals": ["GPS_L1CA"]})
    scenario = sky.scenario
    knowledge = Knowledge(nav=scenario.nav if nav else NavData(), near=scenario.start.plus(3000.0))
    return RunPlan(
        covered=(Covered((GPS_L1CA_SIGNAL,), sky.stream),),
        settings=receiver_settings(config),
        knowledge=knowledge,
        first=0,
        end=int(end_s * sky.rate_hz),
        epoch_s=0.1,
        scout=True,
        threads=threads,
    )


def _run(
    plan: RunPlan, source: object, knowledge: Knowledge | None = None, block_s: float | None = None
) -> tuple[Engine, list[StepResult]]:
    with workers(plan.threads) as executor:
        engine = Engine(plan, source, knowledge or plan.knowledge, executor, block_s)  # type: ignore[arg-type]
        return engine, list(engine.steps())


@cache
def _causal() -> tuple[Engine, list[StepResult]]:
    """A receiver that was switched on, with a NAV file."""
    return _run(_plan(shared_sky(), 10.0), shared_sky())


@cache
def _scouted() -> tuple[Engine, list[StepResult]]:
    """After a scout pass over the beginning, once more from sample 0 on."""
    sky = shared_sky()
    plan = _plan(sky, 10.0)
    scout = ScoutPass(Engine(plan, sky, plan.knowledge, None), plan)
    assert len(list(scout.steps())) < 75  # everything is known after a subframe
    return _run(plan, sky, scout.knowledge)


def _fixes(results: list[StepResult]) -> list[Fix]:
    return [fix for result in results for fix in result.fixes if fix.output]


def _history(results: list[StepResult], satellite: str) -> list[tuple[Fix, Observation]]:
    return [
        (fix, observation)
        for fix in _fixes(results)
        for observation in fix.epoch.observations
        if observation.satellite == satellite
    ]


def _satellite(schedule: float | tuple[tuple[float, float], ...]) -> str:
    wanted = schedule if isinstance(schedule, tuple) else ((0.0, schedule),)
    return next(e.satellite for e in shared_sky().scenario.emitters if e.cn0_dbhz == wanted)


# --- when ----------------------------------------------------------------------------------------


def test_causal_receiver_fixes_right_after_the_first_hand_over_words() -> None:
    """Knows nothing before, and needs no more than the words themselves."""
    engine, results = _causal()
    valid = [fix for fix in _fixes(results) if fix.solution.valid]
    first_s = valid[0].epoch.instant.sample / shared_sky().rate_hz
    assert SUBFRAME_AT_S + 1.2 < first_s < SUBFRAME_AT_S + 1.8
    assert not [f for result in results[: int(first_s * 10) - 1] for f in result.fixes]
    assert engine.receiver.clock is not None


def test_scout_pass_puts_fixes_and_observations_at_the_beginning() -> None:
    _, results = _scouted()
    fixes = _fixes(results)
    rate_hz = shared_sky().rate_hz
    assert next(f for f in fixes if f.solution.valid).epoch.instant.sample < 0.35 * rate_hz
    tags = np.array([round(fix.epoch.time.tow_s * 10) for fix in fixes])
    np.testing.assert_array_equal(np.diff(tags), 1)  # none missing
    assert sum(fix.solution.valid for fix in fixes) == len(fixes)


def test_satellites_are_told_how_far_they_came() -> None:
    engine, _ = _scouted()
    outcomes = {o.satellite: o for o in engine.receiver.accounts.outcomes}
    above_mask = [s for s in map(_satellite, STEADY_DBHZ) if outcomes[s].stage == "used"]
    assert len(above_mask) >= 7
    gone = outcomes[_satellite(BLOCKED_5_S)]
    assert "lost" in gone.reason or gone.stage == "used"
    absent = [s for s in outcomes if s not in {e.satellite for e in shared_sky().scenario.emitters}]
    assert not any(outcomes[s].stage in {"acquired", "pulled in", "used"} for s in absent)


@pytest.mark.slow
def test_a_fast_receiver_is_found_at_once_too() -> None:
    """An aircraft: the place of the scout pass is kilometres away, its speed unknown."""
    path = Line((0.6, 0.8, 0.0), smooth_profile([(0.0, 250.0)]))
    sky = make_sky((44.0, 43.0, 42.0, 41.0, 40.0, 40.0, 39.0), 9.0, path=path, seed=3)
    plan = _plan(sky, 9.0)
    scout = ScoutPass(Engine(plan, sky, plan.knowledge, None), plan)
    assert len(list(scout.steps())) > 50
    _, results = _run(plan, sky, scout.knowledge)
    first = [event.satellite for event in results[0].events if event.what == "acquired"]
    assert sorted(first) == sorted(e.satellite for e in sky.scenario.emitters)
    valid = [f.solution for f in _fixes(results) if f.solution.valid]
    speeds = [np.linalg.norm(s.v_e_mps) for s in valid[10:]]
    assert np.mean(speeds) == pytest.approx(250.0, abs=0.2)


# --- how well ------------------------------------------------------------------------------------


@pytest.mark.parametrize("run", [_causal, _scouted])
def test_position_velocity_and_clock(run: object) -> None:
    sky = shared_sky()
    truth_e_m = sky.scenario.vehicle.point(np.zeros(1)).r_m[0]
    solutions = [f.solution for f in _fixes(run()[1]) if f.solution.valid]  # type: ignore[operator]
    late = solutions[15:]
    errors_m = np.array([s.r_e_m - truth_e_m for s in late])
    assert np.max(np.linalg.norm(errors_m, axis=1)) < 12.0
    assert np.linalg.norm(np.mean(errors_m, axis=0)) < 5.0
    assert np.linalg.norm(np.mean([s.v_e_mps for s in late], axis=0)) < 0.1
    assert np.max(np.abs([s.clock_s for s in late])) < 1e-6


def test_the_clock_model_is_the_receiver_s_clock() -> None:
    """Bias and drift as simulated: counter − GPST = 0.2 ms + 1.5e-7 t."""
    engine, results = _causal()
    clock = engine.receiver.clock
    assert clock is not None
    sky = shared_sky()
    for fix in _fixes(results)[5:]:
        n = fix.epoch.instant.sample + fix.epoch.instant.fraction
        true_s = n / sky.rate_hz - 2.0e-4 - 1.5e-7 * n / sky.rate_hz
        tag_s = fix.epoch.time.since(sky.scenario.start)
        assert tag_s - true_s == pytest.approx(0.0, abs=1e-6)
    assert clock.drift_sps == pytest.approx(1.5e-7, abs=2e-9)


def test_tags_are_whole_multiples_of_the_interval() -> None:
    for fix in _fixes(_causal()[1]):
        tenths = fix.epoch.time.tow_s * 10.0
        assert tenths == pytest.approx(round(tenths), abs=1e-7)


def _against_truth(satellite: str, results: list[StepResult]) -> tuple[FloatArray, FloatArray]:
    """Pseudorange and carrier errors, m and cycles, at the instants they were taken at.

    Truth at that sample, referred to the tag: what one receiver clock makes of it.
    """
    sky, code_m, phase = shared_sky(), [], []
    for fix, seen in _history(results, satellite):
        n = fix.epoch.instant.sample + fix.epoch.instant.fraction
        truth = sky.truth(satellite, np.array([n]))
        # Through whole ns: seconds of week as a float are good for 0.1 cycle only.
        tag_s = (to_ns(fix.epoch.time) - to_ns(sky.scenario.start)) / NS
        sent_s = float(truth.sent_s[0]) - (sky.scenario.start.tow_s - truth.whole_s)
        code_m.append(seen.pseudorange_m - SPEED_OF_LIGHT_MPS * (tag_s - sent_s))
        lag_s = tag_s - n / sky.rate_hz
        phase.append(seen.carrier_cycles - (CARRIER_HZ * lag_s - float(truth.carrier_cycles[0])))
    return np.array(code_m), np.array(phase)


def test_pseudoranges_and_phases_are_those_of_the_instant() -> None:
    """Phase by whole cycles once the polarity is known; no drift between code and carrier."""
    engine, results = _scouted()
    assert engine.receiver.clock is not None
    origin_s = (engine.receiver.clock.origin_ns - to_ns(shared_sky().scenario.start)) / NS
    for cn0_dbhz in STEADY_DBHZ[:6]:
        satellite = _satellite(cn0_dbhz)
        code_m, phase = _against_truth(satellite, results)
        # A whole number of cycles near the pseudorange, as the first epoch had it.
        assert abs(phase[0] * SPEED_OF_LIGHT_MPS / CARRIER_HZ - code_m[0]) < 25.0
        phase += CARRIER_HZ * origin_s  # phases count from the clock model's origin: all alike
        seen = [o for _, o in _history(results, satellite)]
        late = slice(25, None)
        assert abs(np.mean(code_m[late])) < 3.0
        assert np.std(code_m[late]) < 2.0
        known = np.array([o.carrier_valid and not o.half_cycle for o in seen])
        assert known[late].all()
        whole = phase[known] - np.round(np.median(phase[known]))
        assert np.max(np.abs(whole)) < 0.06  # whole cycles: no half is left
        assert abs(np.mean(whole)) < 0.01


def test_slips_are_told_once_and_polarity_settles() -> None:
    """LLI bit 0 at the first phase, and where half a cycle was put right; never again."""
    for _, results in (_scouted(), _causal()):
        for cn0_dbhz in STEADY_DBHZ[:6]:
            satellite = _satellite(cn0_dbhz)
            seen = [o for _, o in _history(results, satellite) if o.carrier_valid]
            flagged = [k for k, o in enumerate(seen) if o.slip]
            assert flagged[0] == 0
            assert len(flagged) <= 2
            for k in flagged[1:]:  # the half cycle and its flag change together
                assert seen[k - 1].half_cycle
                assert not seen[k].half_cycle
            assert not any(o.half_cycle for o in seen[20:])
            for before, after in pairwise(seen):
                if after.half_cycle and not before.half_cycle:
                    assert after.slip


def test_no_jump_without_a_flag() -> None:
    """Wherever no slip is told the phase runs on as the Doppler says, to a tenth of a cycle."""
    results = _scouted()[1]
    for schedule in (*STEADY_DBHZ[:6], BLOCKED_1_S):
        history = _history(results, _satellite(schedule))
        for (before_fix, before), (fix, after) in pairwise(history):
            if not (before.carrier_valid and after.carrier_valid) or after.slip:
                continue
            step_s = fix.epoch.time.since(before_fix.epoch.time)
            expected = -0.5 * (before.doppler_hz + after.doppler_hz) * step_s
            assert after.carrier_cycles - before.carrier_cycles == pytest.approx(expected, abs=0.2)


def test_doppler_is_minus_the_rate_of_the_phase() -> None:
    """Alike for all satellites; what the clock's steering adds is common to them and small."""
    results, gaps_hz = _scouted()[1], []
    for cn0_dbhz in STEADY_DBHZ[:6]:
        history = _history(results, _satellite(cn0_dbhz))[20:]
        times = np.array([fix.epoch.time.tow_s for fix, _ in history])
        phase = np.array([o.carrier_cycles for _, o in history])
        doppler = np.array([o.doppler_hz for _, o in history])
        slope = (phase[-1] - phase[0]) / (times[-1] - times[0])
        gaps_hz.append(slope + np.mean(0.5 * (doppler[1:] + doppler[:-1])))
    assert np.ptp(gaps_hz) < 0.01
    assert abs(np.mean(gaps_hz)) < 0.15


def test_a_blockage_shows_as_a_slip_on_return() -> None:
    history = _history(_scouted()[1], _satellite(BLOCKED_1_S))
    start = shared_sky().scenario.start
    seen_s = np.array([fix.epoch.time.since(start) for fix, _ in history])
    gone = (seen_s > 4.25) & (seen_s < 5.0)
    assert not gone.any()
    back = [o for (fix, o), s in zip(history, seen_s, strict=True) if s > 5.0 and o.carrier_valid]
    assert back[0].slip
    assert sum(o.slip for o in back) <= 2  # the second where the half cycle is put right


def test_lost_satellite_is_found_again() -> None:
    """Blocked for five seconds: its channel ends, a new one starts within a second or two."""
    _, results = _scouted()
    satellite, rate_hz = _satellite(BLOCKED_5_S), shared_sky().rate_hz
    events = [
        (event.sample / rate_hz, event.what)
        for result in results
        for event in result.events
        if event.satellite == satellite
    ]
    assert [what for _, what in events if what in {"hold", "lost"}] == ["hold", "lost"]
    again = [s for s, what in events if what == "acquired" and s > 8.9]
    assert again
    assert again[0] < 10.0


# --- independence --------------------------------------------------------------------------------


def _same(one: list[StepResult], other: list[StepResult]) -> None:
    """Every float of every fix, observation, report and event."""
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        assert a.reports == b.reports
        assert a.events == b.events
        assert [f.epoch for f in a.fixes] == [f.epoch for f in b.fixes]
        for f, g in zip(a.fixes, b.fixes, strict=True):
            np.testing.assert_array_equal(f.solution.r_e_m, g.solution.r_e_m)
            np.testing.assert_array_equal(f.solution.v_e_mps, g.solution.v_e_mps)
            assert f.solution.clock_s == g.solution.clock_s
            assert f.solution.residuals_m == g.solution.residuals_m


@cache
def _short() -> list[StepResult]:
    sky = shared_sky()
    return _run(_plan(sky, SHORT_S), sky)[1]


@pytest.mark.parametrize(("block_s", "threads"), [(0.005, 1), (0.02, 2), (0.1, 2)])
def test_blocks_and_threads_make_no_difference(block_s: float, threads: int) -> None:
    sky = shared_sky()
    _same(_run(_plan(sky, SHORT_S, threads=threads), sky, block_s=block_s)[1], _short())


class _Mangled:
    """A source whose samples after an instant are something else."""

    def __init__(self, sky: Sky, from_s: float) -> None:
        self._sky, self._from = sky, int(from_s * sky.rate_hz)

    def read(self, stream: str, first: int, count: int) -> SampleBlock:
        block = self._sky.read(stream, first, count)
        samples = block.samples.copy()
        samples[max(0, self._from - first) :] = 1
        return replace(block, held=samples)


def test_nothing_looks_ahead() -> None:
    """What comes later changes nothing of what was said before."""
    sky = shared_sky()
    _, mangled = _run(_plan(sky, SHORT_S), _Mangled(sky, 5.5))
    _same(mangled[:55], _short()[:55])
    assert mangled[-1].reports != _short()[-1].reports
