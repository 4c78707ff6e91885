"""A channel's generators of carrier and code: their state, their commands, and what they were.

The code runs along with the carrier; what its loop adds is an offset of the chip rate. A command
begins within a code period, which is counted since the channel's start.
"""

from __future__ import annotations

from typing import NamedTuple

from deepgnss.core.jit import compilable
from deepgnss.core.records import NcoCommand
from deepgnss.receiver.interval import Heard, Interval, turned
from deepgnss.receiver.signals import Signal
from deepgnss.receiver.trackers import (
    Correction,
    NcoState,
    advance,
    corrected,
)

_HISTORY_UPDATES = 3  # commands kept for observables of the epoch before


class Run(NamedTuple):
    """What the generators did on a command, and what its correlations say of its end."""

    samples: int
    seconds: float
    carrier: NcoState  # at the end, corrected
    corrected_cycles: float  # of it, what the correction has added
    turned_cycles: float  # since the command
    shifted_chips: float  # correction of the code at the end


class Rates(NamedTuple):
    """What a pair of generators runs at, and on."""

    sample_hz: float
    chip_hz: float
    to_code: float  # cycles of the carrier per chip
    length: float  # chips of a code period


@compilable
def periods_before(rates: Rates, command: NcoCommand, sample: int) -> int:
    """Code periods that end before a sample, counted from that of the command on."""
    there_s = (sample - command.sample) / rates.sample_hz
    chips = command.code_chips + there_s * (command.code_hz + 0.5 * there_s * command.code_hzps)
    return int(chips // rates.length)


@compilable
def seconds_until(rates: Rates, command: NcoCommand, periods: float) -> float:
    """Time after the command's sample until so many code periods are over."""
    chips = periods * rates.length - command.code_chips
    t = chips / command.code_hz
    return chips / (command.code_hz + 0.5 * command.code_hzps * t)


@compilable
def run_through(
    rates: Rates,
    carrier: NcoState,
    correction: Correction,
    code: Correction,
    foreseen: Correction,
    middle_s: float,
    end_s: float,
) -> Run:
    """Run to the last sample of a command with what was found to be lacking.

    Corrections count in the middle, what is foreseen at the end.
    """
    whole = int(end_s * rates.sample_hz)
    elapsed_s = whole / rates.sample_hz
    before = advance(carrier, elapsed_s)
    after = corrected(before, correction, elapsed_s - middle_s)
    after = corrected(after, foreseen, elapsed_s - end_s)
    return Run(
        whole,
        elapsed_s,
        after,
        after.phase - before.phase,
        after.phase - carrier.phase,
        code.phase + code.frequency * (elapsed_s - middle_s),
    )


@compilable
def command_of(
    rates: Rates, sample: int, carrier: NcoState, code_chips: float, code_offset_hz: float
) -> NcoCommand:
    """The command that the generators' state amounts to."""
    return NcoCommand(
        sample,
        carrier.phase,
        carrier.frequency,
        carrier.rate,
        code_chips,
        rates.chip_hz + carrier.frequency / rates.to_code + code_offset_hz,
        carrier.rate / rates.to_code,
    )


@compilable
def next_command(
    rates: Rates,
    command: NcoCommand,
    run: Run,
    carrier: NcoState,
    code_offset_hz: float,
    periods: int,
) -> NcoCommand:
    """The command after a run, over so many code periods.

    carrier: at the run's end, led on.
    """
    code_now = NcoState(command.code_chips, command.code_hz, command.code_hzps)
    chips = (
        advance(code_now, run.seconds).phase
        - periods * rates.length
        + run.shifted_chips
        + run.corrected_cycles / rates.to_code
    )
    return command_of(rates, command.sample + run.samples, carrier, chips, code_offset_hz)


class Generators:
    """State and command of both generators, and the commands before."""

    def __init__(
        self,
        signal: Signal,
        sample_rate_hz: float,
        longest_periods: int,
        sample: int,
        code_chips: float,
        doppler_hz: float,
    ) -> None:
        """Start at the next code epoch after a sample with its code phase and Doppler.

        longest_periods: code periods of the longest interval there will be.
        """
        chip_hz = signal.id.chip_rate_hz
        length = float(signal.id.code_chips)
        self.rates = Rates(sample_rate_hz, chip_hz, signal.carrier_to_code, length)
        self.carrier = NcoState(0.0, doppler_hz, 0.0)
        self.code_offset_hz = 0.0
        self.periods = 0  # that the channel had gone through when the command began
        self.history: list[Interval] = []
        self._kept = int(_HISTORY_UPDATES * longest_periods * signal.period_s * sample_rate_hz)
        chip_rate = chip_hz * (1.0 + doppler_hz / signal.id.carrier_hz)
        wait_s = (length - code_chips % length) / chip_rate
        start = sample + int(wait_s * sample_rate_hz)
        chips = ((start - sample) / sample_rate_hz - wait_s) * chip_rate
        self.command = self._command(start, chips)

    # --- a command's time --------------------------------------------------------------------

    def reached(self, sample: int) -> int:
        """Code periods that end before a sample, counted from that of the command on."""
        return periods_before(self.rates, self.command, sample)

    def until_s(self, periods: float) -> float:
        """Time after the command's sample until so many code periods are over."""
        return seconds_until(self.rates, self.command, periods)

    def seconds_since(self, sample: int) -> float:
        """Time from a sample to the command's."""
        return (self.command.sample - sample) / self.rates.sample_hz

    # --- on to the next command --------------------------------------------------------------

    def run(
        self,
        carrier: Correction,
        code: Correction,
        foreseen: Correction,
        middle_s: float,
        end_s: float,
    ) -> Run:
        """Run to the last sample of a command with what was found to be lacking."""
        return run_through(self.rates, self.carrier, carrier, code, foreseen, middle_s, end_s)

    def go_on(self, run: Run, carrier: NcoState, code: Correction, periods: int) -> None:
        """Begin the next command.

        carrier: at the run's end, led on; code: what it was corrected by; periods: that are over.
        """
        self.carrier = carrier
        self.code_offset_hz += code.frequency
        self.periods += periods
        self.command = next_command(
            self.rates, self.command, run, carrier, self.code_offset_hz, periods
        )

    def resume(self, command: NcoCommand, code_offset_hz: float, periods: int) -> None:
        """Go on from a command that was made elsewhere, after so many code periods in all."""
        self.carrier = NcoState(command.carrier_cycles, command.carrier_hz, command.carrier_hzps)
        self.command, self.code_offset_hz = command, code_offset_hz
        self.periods = periods

    def _command(self, sample: int, code_chips: float) -> NcoCommand:
        return command_of(self.rates, sample, self.carrier, code_chips, self.code_offset_hz)

    # --- put right -----------------------------------------------------------------------------

    def change(
        self,
        *,
        off_hz: float = 0.0,
        rate_hzps: float | None = None,
        carrier: NcoState | None = None,
        code_chips: float | None = None,
    ) -> None:
        """Give the present command anew, with another carrier or code phase."""
        one = self.carrier if carrier is None else carrier
        self.carrier = NcoState(
            one.phase, one.frequency + off_hz, one.rate if rate_hzps is None else rate_hzps
        )
        chips = self.command.code_chips if code_chips is None else code_chips
        self.command = self._command(self.command.sample, chips)

    def move(self, cycles: float, *, code: bool) -> float:
        """Turn the carrier (+Doppler), also where it is not yet observed; chips the code moved.

        code: it is an open loop that is put right, and the code goes along.
        """
        chips = cycles / self.rates.to_code if code else 0.0
        self.carrier = self.carrier._replace(phase=self.carrier.phase + cycles)
        self.command = turned(self.command, cycles, chips)
        self.history = [
            i._replace(command=turned(i.command, cycles, chips)) if i.coasting or not code else i
            for i in self.history
        ]
        return chips

    def shift_code(self, chips: float) -> None:
        """Move the code, from the present command on, and keep no rate by which it went astray."""
        self.code_offset_hz = 0.0
        self.command = turned(self.command, 0.0, chips)
        self.history[-1] = self.history[-1]._replace(
            command=turned(self.history[-1].command, 0.0, chips)
        )

    # --- history -------------------------------------------------------------------------------

    def forget_old(self) -> None:
        """Keep but the commands that observables still need."""
        oldest = self.command.sample - self._kept
        self.history = [i for i in self.history if i.command.sample >= oldest]

    def correct(self, commands: int, carrier: Correction, middle_s: float, window: Heard) -> None:
        """Note what the last commands were found to lack.

        middle_s: to which the correction refers, after the last command.
        """
        for k in range(-commands, 0):
            interval = self.history[k]
            later_s = self.seconds_since(interval.command.sample)
            self.history[k] = interval._replace(
                correction=carrier, middle_s=middle_s + later_s, window=window
            )

    def take_back_phase(self, commands: int) -> None:
        """The last commands have no phase after all."""
        for k in range(-commands, 0):
            self.history[k] = self.history[k]._replace(phase_valid=False)

    def at(self, sample: int) -> Interval:
        """The interval that holds at a sample of the epoch just run."""
        for interval in reversed(self.history):
            if interval.command.sample <= sample:
                return interval
        return self.history[0]
