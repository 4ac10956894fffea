# SPDX-License-Identifier: Apache-2.0
"""Rest is told by tracks, IMU and estimate together; without tracks nothing is overruled."""

import numpy as np
import pytest

from skyhaul.perception.vio.api import NavState, TrackFrame, V
from skyhaul.perception.vio.intake import Intake
from skyhaul.perception.vio.rest import Rest, rest_of
from skyhaul.perception.vio.standing import Standing
from skyhaul.sensors.api import ImuReading
from skyhaul.types import GRAVITY_MPS2

AT = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 2))


def taken(tracks):
    """Three seconds without rate under gravity's force, with tracks that stand."""
    stamps = 5_000 * np.arange(601)
    force = np.tile([0.0, 0.0, GRAVITY_MPS2], (601, 1))
    frames = tuple(
        TrackFrame(50_000 * k, np.arange(tracks), np.zeros(tracks, np.int64), AT[:tracks].copy())
        for k in range(61)
    )
    return Intake(3.0, ImuReading(stamps, np.zeros((601, 3)), force), frames, checked=True)


def moves(speed_mps):
    still = np.zeros(3)
    v_WI = np.array([speed_mps, 0.0, 0.0])
    return NavState(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), v_WI, still, still)


@pytest.mark.parametrize(
    ("tracks", "speed_mps", "sigma_mps", "rest"),
    [
        (20, 0.0, 0.05, Rest.YES),
        (20, 1.0, 0.05, Rest.DESPITE),
        (0, 0.0, 0.05, Rest.YES),
        (0, 1.0, 0.05, Rest.NO),  # a steady flight in the dark
        (0, 1.0, 1.0, Rest.NO),  # the same, with a velocity that is no longer known well
    ],
)
def test_who_sees_nothing_does_not_know_that_it_stands(tracks, speed_mps, sigma_mps, rest):
    covariance = 1e-4 * np.eye(15)
    covariance[V, V] = sigma_mps**2 * np.eye(3)
    assert rest_of(Standing(), taken(tracks), moves(speed_mps), covariance) is rest
