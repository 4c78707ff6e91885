"""C/A codes against the interface document and their known correlation."""

from __future__ import annotations

import numpy as np
import pytest

from deepgnss.receiver.signals import GPS_L1CA_SIGNAL, SIGNALS, ca_code, code_runs

# First ten chips of PRN 1–32 in octal (IS-GPS-200 table 3-Ia).
FIRST_CHIPS_OCTAL = (
    1440, 1620, 1710, 1744, 1133, 1455, 1131, 1454, 1626, 1504, 1642, 1750, 1764, 1772, 1775, 1776,
    1156, 1467, 1633, 1715, 1746, 1763, 1063, 1706, 1743, 1761, 1770, 1774, 1127, 1453, 1625, 1712,
)  # fmt: skip

every_prn = pytest.mark.parametrize("prn", range(1, 33))


@every_prn
def test_first_chips(prn: int) -> None:
    """The first octal digit is one chip, the others three each; logic 0 is +1."""
    text = str(FIRST_CHIPS_OCTAL[prn - 1])
    bits = text[0] + "".join(f"{int(digit):03b}" for digit in text[1:])
    assert "".join(str((1 - chip) // 2) for chip in ca_code(prn)[:10]) == bits


@every_prn
def test_gold_code_properties(prn: int) -> None:
    """512 chips of one sign against 511; autocorrelation off zero −65, −1 or 63."""
    code = ca_code(prn).astype(np.int64)
    assert set(np.unique(code)) == {-1, 1}
    assert int(code.sum()) == -1  # 512 ones (−1), 511 zeros
    spectrum = np.fft.fft(code)
    correlation = np.rint(np.fft.ifft(spectrum * spectrum.conj()).real).astype(int)
    assert correlation[0] == 1023
    assert set(correlation[1:]) <= {-65, -1, 63}


def test_cross_correlation_takes_three_values() -> None:
    spectra = np.fft.fft([ca_code(prn) for prn in range(1, 33)])
    for first in range(32):
        for second in range(first):
            values = np.fft.ifft(spectra[first] * spectra[second].conj()).real
            assert set(np.rint(values).astype(int)) <= {-65, -1, 63}


def test_codes_cannot_be_written_to() -> None:
    with pytest.raises(ValueError, match="read-only"):
        ca_code(5)[0] = 1


@every_prn
def test_runs_unroll_to_the_code(prn: int) -> None:
    runs = code_runs("GPS_L1CA", prn)
    lengths = np.diff(runs.edges).astype(int)
    assert runs.edges[0] == 0.0
    assert runs.edges[-1] == 1023.0
    assert np.all(runs.signs[1:] != runs.signs[:-1])
    np.testing.assert_array_equal(np.repeat(runs.signs, lengths), ca_code(prn))


def test_the_signal_s_own_numbers() -> None:
    signal = GPS_L1CA_SIGNAL
    assert signal.period_s == pytest.approx(1e-3, rel=1e-15)
    assert signal.symbol_s == pytest.approx(0.02, rel=1e-15)
    assert signal.carrier_to_code == 1540.0
    assert signal.satellite(5) == "G05"
    assert SIGNALS[signal.id.name] == (signal,)
