"""Positions that take the navigation as a measurement: as good as they say, and nobody's news."""

from __future__ import annotations

from functools import cache
from typing import Literal

import numpy as np
import pytest
from ranging_drive import PARAMETERS, START, Driven, drive, world

from deepgnss.core.frames import C_ne
from deepgnss.core.records import FloatArray, NavSolution
from deepgnss.deep.placing import LOOSEST_M, Placing, horizontal_sigma_m

FROM_S, TO_S = 25.0, 33.0
Way = Literal["loose", "tight"]


@cache
def driven(coupling: Way, count: int, *, placed: bool = True) -> Driven:
    """A drive in which all but some satellites are blocked for a while."""
    given = world(36.0, coupling)
    left = given.names[:count]

    def fault(name: str, t: float) -> float | None:
        return None if FROM_S < t <= TO_S and name not in left else 0.0

    return drive(given, fault, placing=Placing(PARAMETERS) if placed else None)


def errors(coupling: Way, found: list[NavSolution]) -> tuple[FloatArray, FloatArray]:
    """Horizontal errors (n, 2) while satellites are blocked, and covariances (n, 2, 2)."""
    given = world(36.0, coupling)
    level = C_ne(given.vehicle.latitude_rad, given.vehicle.longitude_rad)[:2]
    during = [s for s in found if s.valid and FROM_S < s.time.since(START) <= TO_S + 1e-6]
    off = [level @ (s.r_e_m - given.antenna_e_m(s.time.since(START))) for s in during]
    P = [level @ s.covariance_m2[:3, :3] @ level.T for s in during]
    return np.array(off), np.array(P)


@pytest.mark.parametrize("coupling", ["loose", "tight"])
def test_with_two_satellites_positions_go_on(coupling: Way) -> None:
    """No fix by ranges alone for 8 s; the navigation's drift stays within what is claimed."""
    out = driven(coupling, 2)
    assert len(errors(coupling, out.alone)[0]) == 0
    off_m, P_m2 = errors(coupling, out.placed)
    assert len(off_m) == 40
    nees = np.einsum("ki,kij,kj->k", off_m, np.linalg.inv(P_m2), off_m)
    assert np.median(nees) < 4.0
    assert {s.source for s in out.placed if s.time.since(START) > FROM_S} == {"gnss+ins"}


def test_without_a_single_one_it_is_dead_reckoning_and_says_so() -> None:
    dead = [s for s in driven("loose", 0).placed if FROM_S < s.time.since(START) <= TO_S]
    assert len(dead) >= 39
    for solution in dead:
        assert (solution.source, solution.used) == ("ins", ())
        assert horizontal_sigma_m(solution.covariance_m2, solution.r_e_m) <= LOOSEST_M


@pytest.mark.parametrize("coupling", ["loose", "tight"])
def test_the_navigation_does_not_hear_of_them(coupling: Way) -> None:
    """Its innovations are the same bit for bit."""

    def told(out: Driven) -> list[tuple[str, bytes]]:
        return [(i.kind, i.innovation.tobytes()) for i in out.innovations]

    assert told(driven(coupling, 2)) == told(driven(coupling, 2, placed=False))
