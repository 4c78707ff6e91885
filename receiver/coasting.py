"""A channel's open loop: what its loops teach for it, its way out, and its way back.

`open_loop` remembers and judges; here the generators are moved by it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from deepgnss.core.records import FloatArray, NcoCommand
from deepgnss.receiver.generators import Generators, Run
from deepgnss.receiver.interval import led_on
from deepgnss.receiver.leading import Leading
from deepgnss.receiver.modes import NO_AIDING, AidingRate, Coast, Mode
from deepgnss.receiver.open_loop import OpenLoop, Passed
from deepgnss.receiver.signals import Signal
from deepgnss.receiver.trackers import NcoState
from deepgnss.receiver.updates import Updates

_FAR_OFF_HZ = 10.0  # a signal's return: a frequency loop would take its time

Told = Callable[[int, int], FloatArray | None]
"""Signs of symbols from a code period on, how many; None where they are not all known."""


class Began(NamedTuple):
    """Generators and prediction when a command was given."""

    command: NcoCommand
    carrier: NcoState
    periods: int
    aid: AidingRate


class Coasting:
    """What a channel is without its signal."""

    def __init__(
        self,
        signal: Signal,
        generators: Generators,
        leading: Leading,
        limit_cycles: float,
    ) -> None:
        """limit_cycles: 1σ up to which a phase carried on is right to the half cycle."""
        self.loop = OpenLoop(signal, generators.rates.sample_hz, limit_cycles)
        self._nco = generators
        self._leading = leading

    @property
    def _here(self) -> int:
        return self._nco.command.sample

    def now(self) -> Began:
        """Generators and prediction as they are."""
        nco = self._nco
        return Began(nco.command, nco.carrier, nco.periods, self._leading.now)

    # --- trust -------------------------------------------------------------------------------

    @property
    def carried(self) -> bool:
        """Whether a phase is carried on, or was until the signal came back."""
        return self.loop.carried

    def vouched_for(self, share: float) -> bool:
        """Whether the phase carried on is good to so many times the limit."""
        return self._leading.aided and self.loop.vouched(self._here, share)

    def kept(self, half_cycle: float | None, told: Told) -> bool:
        """Whether it is right to the half cycle, or the whole one where symbols tell."""
        return self.vouched_for(1.0) or (
            self.vouched_for(2.0) and self._signs(half_cycle, told) is not None
        )

    def look_after(self, move: Coast | None) -> None:
        """Somebody looks after open loops, and has moved this one or has nothing to say of it."""
        self.loop.look_after(self._here, move)

    def _signs(self, half_cycle: float | None, told: Told) -> list[FloatArray] | None:
        """Signs of the last symbols of an open loop as they shall be seen; None if not known."""
        if half_cycle is None:
            return None
        upright = -1.0 if half_cycle else 1.0
        found = []
        for first, sums in self.loop.symbols:
            one = told(first, sums.size)
            if one is None:
                return None
            found.append(upright * one)
        return found

    # --- memory ------------------------------------------------------------------------------

    def saw(self, run: Run) -> None:
        """See what loops did on a command beyond what was predicted of it."""
        if self._leading.aided:
            shifted_chips = run.shifted_chips + self._nco.code_offset_hz * run.seconds
            self.loop.saw(run.turned_cycles, shifted_chips, self._leading.now, run.seconds)

    def learn_phase(self, run: Run) -> None:
        """Take what a phase loop turned the carrier by."""
        if self._leading.aided:
            self.loop.learn_phase(run.turned_cycles, self._leading.now, run.seconds)

    def learn_frequency(self, run: Run) -> None:
        """The same of a loop that follows the frequency alone."""
        if self._leading.aided:
            frequency_hz = self._nco.carrier.frequency
            self.loop.learn_frequency(frequency_hz, self._leading.now, run.seconds)

    def remember(self, began: Began, power: float) -> None:
        """Keep a command whose interval is over, for the case that its signal is just falling."""
        if began.aid == NO_AIDING or not self._leading.aided:
            self.loop.forget()
            return
        chips = self._chips(began)
        self.loop.remember(began.command.sample, began.carrier, chips, began.aid, power)

    def go_on(self, updates: Updates, periods: int, seconds: float) -> None:
        """Keep the command and those after it that are over, through updates done elsewhere.

        periods: code periods of each; seconds: what the mean offset is made of at last.
        """
        if not self._leading.aided:
            self.loop.forget()
            return
        nco, length = self._nco, self._nco.rates.length
        begun = nco.periods * length
        passed = [
            Passed(
                command.sample,
                NcoState(command.carrier_cycles, command.carrier_hz, command.carrier_hzps),
                begun + k * periods * length + command.code_chips,
                aid,
                offset_hz,
                power,
            )
            for k, (command, aid, offset_hz, power) in enumerate(
                zip(
                    (nco.command, *updates.commands[:-1]),
                    (self._leading.now, *updates.aids[:-1]),
                    updates.offsets_hz,
                    updates.powers,
                    strict=True,
                )
            )
        ]
        self.loop.memory.go_on(passed, updates.offsets_hz[-1], seconds)

    def _chips(self, began: Began) -> float:
        return began.periods * self._nco.rates.length + began.command.code_chips

    def judged(self) -> str:
        """What the last gap came to, once its return was long enough ago."""
        return self.loop.judged(self._here)

    # --- the way out and back ------------------------------------------------------------------

    def begin(self, power: float | None, phase_since: int | None) -> str:
        """Go back to before the signal fell, and on from there by aiding alone; from when.

        power: of the signal in its mean, None: it was faint. phase_since: sample of phase lock.
        """
        nco = self._nco
        led = self.loop.begin(self._here, self._leading.now, power, phase_since)
        if not led:
            return ""
        nco.code_offset_hz = 0.0
        nco.change(
            carrier=led[-1].carrier, code_chips=led[-1].chips - nco.periods * nco.rates.length
        )
        carried = self.vouched_for(2.0)
        nco.history = led_on(nco.history, led[:-1], nco.rates.length, phase=carried)
        phase = "" if carried else "out"
        return f"; from {nco.seconds_since(led[0].sample):.2f} s before open loop with{phase} phase"

    def end(self, mode: Mode, half_cycle: float | None, told: Told) -> None:
        """The signal is back, to be followed in a mode.

        A phase carried on is turned to what its first symbols show.
        """
        nco, off_hz = self._nco, self.loop.off_hz
        if mode is Mode.FREQUENCY and abs(off_hz) > _FAR_OFF_HZ:
            nco.change(off_hz=off_hz)
        self.loop.end(self._here, nco.carrier.frequency, self._leading.now)
        if mode is Mode.PHASE:
            turn = self.loop.seen_cycles(self._signs(half_cycle, told))
            nco.change(carrier=nco.carrier._replace(phase=nco.carrier.phase + turn))
