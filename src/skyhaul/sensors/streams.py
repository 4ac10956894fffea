# SPDX-License-Identifier: Apache-2.0
"""Random streams of the sensors: one for each sensor of each body, whoever else draws.

A stream is named by the run's seed, the body and the sensor, so that readings do not depend on
the order in which sensors are stepped, nor on the process in which that happens.
"""

from enum import IntEnum

import numpy as np

PAYLOAD_BODY = 0
"""The load's number among the bodies; vehicle i is body 1 + i."""


class Source(IntEnum):
    """What draws from a stream. The numbers are part of every recording: never renumber."""

    IMU = 0
    CAMERAS = 1
    EVENT_CAMERA = 2
    LOAD_CELL = 3
    FAULTS = 4


def stream(seed: int, body: int, source: Source, *part: int) -> np.random.Generator:
    """A fresh generator at the beginning of a stream.

    Args:
        seed: Of the run.
        body: `PAYLOAD_BODY`, or 1 + i for vehicle i.
        source: What draws.
        part: Numbers of a part of the stream, each with a stream of its own.
    """
    return np.random.default_rng(seed_of(seed, body, source, *part))


def seed_of(seed: int, body: int, source: Source, *part: int) -> np.random.SeedSequence:
    """What a stream grows from; arguments as `stream`."""
    return np.random.SeedSequence(seed, spawn_key=(body, int(source), *part))
