# SPDX-License-Identifier: Apache-2.0
"""Who is heard, and who leads by it."""

from itertools import product

import numpy as np
import pytest

from skyhaul.comms.messages import Status
from skyhaul.mission.hearing import SILENT_US, Hearing

N = 4


def beat(i, t_us, hears=(True,) * N):
    return Status(
        stamp_us=t_us, vehicle=i, p_WB=np.zeros(3), v_WB=np.zeros(3), tension=0.5, taut=True,
        attached=True, at_station=True, station_in_s=0.0, on_way_s=1.0,
        faulty=np.zeros(N, np.bool_), hears=np.array(hears), order_us=-1, plan_us=-1,
    )  # fmt: skip


def test_silence_begins_when_the_time_is_over_and_ends_with_the_next_heartbeat():
    hearing = Hearing(1, N)
    hearing.note(100_000, beat(2, 80_000))
    assert hearing.heard(SILENT_US).all()
    np.testing.assert_array_equal(hearing.heard(SILENT_US + 1), [False, True, True, False])
    assert not hearing.alone(100_000 + SILENT_US)
    assert hearing.alone(100_001 + SILENT_US)
    hearing.note(900_000, beat(0, 900_000))
    np.testing.assert_array_equal(hearing.heard(900_000), [True, True, False, False])


@pytest.mark.parametrize("cut", range(N))
@pytest.mark.parametrize(("mute", "deaf"), [(True, False), (False, True), (True, True)])
def test_all_who_hear_each_other_elect_the_same_and_who_is_cut_off_does_not_elect_itself(
    cut, mute, deaf
):
    """Every vehicle's heartbeats, told along the links that are left, for two rounds."""
    t_us = 2 * SILENT_US
    linked = np.ones((N, N), dtype=bool)  # [i, j]: i hears j
    linked[:, cut] &= not mute
    linked[cut, :] &= not deaf
    np.fill_diagonal(linked, True)
    team = [Hearing(i, N) for i in range(N)]
    for _ in range(2):
        for i, j in product(range(N), repeat=2):
            heard = linked[i, j] and i != j
            team[i].note(t_us, beat(j, t_us, team[j].heard(t_us))) if heard else None
    chiefs = [h.chief(t_us, set()) for h in team]
    lowest = min(set(range(N)) - {cut})
    assert [c for i, c in enumerate(chiefs) if i != cut] == [lowest] * (N - 1)
    assert chiefs[cut] != cut


def test_the_faulty_do_not_lead_and_where_all_are_nobody_does():
    hearing = Hearing(1, N)
    assert hearing.chief(0, set()) == 0
    assert hearing.chief(0, {0}) == 1
    assert hearing.chief(0, {0, 1}) == 2
    assert hearing.chief(0, {0, 1, 2, 3}) is None
