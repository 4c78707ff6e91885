"""The epoch engine: samples in, one step per navigation epoch, results out.

    recording ──▶ running sums ──▶ receiver step ──▶ StepResult

The navigation closes its circle here when there is one: aiding goes into the step, the step's
observations into the filter. A file has no cold start, so by default a scout pass over its
beginning decodes time and ephemerides first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from typing import Protocol

from deepgnss.core.records import NavSolution, SampleBlock
from deepgnss.deep.coupled import NO_AIDS, CoupledNavigation, Navigated
from deepgnss.deep.setup import Covered, RunPlan
from deepgnss.receiver.clock import ReceiverClock
from deepgnss.receiver.feed import SumFeed
from deepgnss.receiver.framing import known_symbols
from deepgnss.receiver.receiver import Knowledge, Receiver, StepResult

_SCOUT_LIMIT_S = 120.0
_SCOUT_AFTER_FIX_S = 6.2  # let a whole subframe pass for satellites that synchronized late


class SampleSource(Protocol):
    """What the engine reads from."""

    def read(self, stream: str, first: int, count: int) -> SampleBlock:
        """Samples [first, first + count) of a stream."""
        ...


class Engine:
    """One pass over the samples of all streams with one receiver."""

    def __init__(
        self,
        plan: RunPlan,
        source: SampleSource,
        knowledge: Knowledge,
        executor: Executor | None,
        block_s: float | None = None,
        couple: Callable[[ReceiverClock], CoupledNavigation] | None = None,
    ) -> None:
        """`block_s`: how much is read at a time; no result depends on it.

        couple: makes the inertial navigation once the receiver's clock is known.
        """
        self._plan = plan
        self._source = source
        self._block_s = block_s
        self._couple = couple
        self.coupled: CoupledNavigation | None = None
        self.navigated = Navigated()  # in the last step
        self.receiver = Receiver(
            [(kind, c.stream.sample_rate_hz) for c in plan.covered for kind in c.kinds],
            plan.settings,
            knowledge,
            executor,
            plan.threads,
        )

    def steps(self) -> Iterator[StepResult]:
        """Run epoch by epoch to the end of the plan."""
        plan = self._plan
        rate = plan.stream.sample_rate_hz
        feeds = {covered.id.name: self._feed(covered) for covered in plan.covered}
        first, epoch = plan.first, 0
        while first < plan.end:
            epoch += 1
            end = min(plan.first + round(epoch * plan.epoch_s * rate), plan.end)
            yield self._step(feeds, first, end)
            first = end

    def _step(self, feeds: Mapping[str, SumFeed], first: int, end: int) -> StepResult:
        """Predict, receive, observe, correct: the circle closes here."""
        receiver, clock = self.receiver, self.receiver.clock
        if self._couple is not None and clock is not None and receiver.steered:
            self.coupled = self.coupled or self._couple(clock)
        coupled = self.coupled
        aids = coupled.before(receiver, first, end) if coupled is not None else NO_AIDS
        result = receiver.step(feeds, first, end, aids.profiles, aids.place, aids.screen)
        self.navigated = coupled.after(receiver, result) if coupled is not None else Navigated()
        return replace(
            result,
            fixes=tuple(self.navigated.told(fix) for fix in result.fixes),
            events=(*result.events, *self.navigated.events),
        )

    def _feed(self, covered: Covered) -> SumFeed:
        stream = covered.stream
        return SumFeed(
            lambda first, count: self._source.read(stream.name, first, count),
            stream,
            covered.id.carrier_hz,
            self.receiver.sample_in(stream.sample_rate_hz, self._plan.first),
            self._block_s,
        )


@contextmanager
def workers(threads: int) -> Iterator[Executor | None]:
    """A pool for the channels of an epoch; none for a single thread."""
    if threads < 2:
        yield None
        return
    with ThreadPoolExecutor(threads) as pool:
        yield pool


class ScoutPass:
    """Tracks the beginning of the recording until time, place and ephemerides are known."""

    def __init__(self, engine: Engine, plan: RunPlan) -> None:
        self._engine = engine
        self._plan = plan
        self.first_fix: NavSolution | None = None

    def steps(self) -> Iterator[StepResult]:
        """Run as far as needed; then `knowledge` holds what was learnt."""
        rate = self._plan.stream.sample_rate_hz
        fixed_at: int | None = None
        for result in self._engine.steps():
            yield result
            for fix in result.fixes:
                if self.first_fix is None and fix.solution.valid:
                    self.first_fix, fixed_at = fix.solution, result.end
            if fixed_at is not None and (
                self._complete() or result.end - fixed_at > _SCOUT_AFTER_FIX_S * rate
            ):
                return
            if result.end - self._plan.first > _SCOUT_LIMIT_S * rate:
                return

    def _complete(self) -> bool:
        """Every tracked satellite has told its orbit, and the ionosphere is known."""
        receiver = self._engine.receiver
        nav = receiver.nav
        heard = all(channel.satellite in nav.ephemerides for channel in receiver.channels)
        systems = {channel.signal.id.system for channel in receiver.channels}
        return heard and systems <= set(nav.klobuchar)

    @property
    def knowledge(self) -> Knowledge:
        """What is known at sample 0 of the processing pass."""
        receiver, before = self._engine.receiver, self._plan.knowledge
        symbols = {
            channel.satellite: told
            for channel in receiver.channels
            if (told := known_symbols(channel)) is not None
        }
        known = replace(before, nav=receiver.nav, clock=receiver.clock, symbols=symbols)
        solution = receiver.solution
        if solution is not None and solution.valid:
            known = replace(known, position_e_m=solution.r_e_m)
        return known
