# SPDX-License-Identifier: Apache-2.0
"""The scene as struct of arrays, for the kernels; `scene` fills it."""

from typing import NamedTuple

from skyhaul.sensors.imaging.atlas import Atlas, Grey, Patches, Reading, Spots
from skyhaul.types import Array, IntArray, Mask

ROOM_FACES = ("wall -x", "wall +x", "wall -y", "wall +y", "floor", "ceiling")
"""Names of objects 0 to 5."""
SKY = -2
"""Object id of what is no object."""
NOBODY = -1
"""For `own`: the camera belongs to no vehicle."""
THREAD = 4
"""Code of a thin capsule, beside those of `geometry.shapes`."""
FIRST_PART = len(ROOM_FACES)
"""Codes of hits below this are faces of the room; parts follow."""


CEILING, MIXED = 5, -2
"""Code of the face of the room that may be open; and what is no code of a surface."""


class Parts(NamedTuple):
    """Shapes that objects consist of, k rows."""

    kind: IntArray  # (k,) BOX, SPHERE, CAPSULE or THREAD
    object: IntArray  # (k,) index of its object
    size: Array  # (k, 3) as in `ShapeArrays`; half lengths of threads are posed
    p_OP: Array  # (k, 3) centre in the object's axes [m]
    R_OP: Array  # (k, 3, 3)
    face: IntArray  # (k, 6) textures of the faces -x, +x, -y, +y, -z, +z
    period: Array  # (k,) length of one period of the texture [m]
    gain: Array  # (k,) brightness
    p_WP: Array  # (k, 3) posed
    R_WP: Array  # (k, 3, 3) posed


class Objects(NamedTuple):
    """Where objects are and how they move, m rows; those of the room do not."""

    present: Mask  # (m,)
    p_WO: Array  # (m, 3) [m]
    R_WO: Array  # (m, 3, 3)
    v_WO: Array  # (m, 3) velocity of the origin [m/s]
    w_WO: Array  # (m, 3) angular velocity, W axes [rad/s]


class Balls(NamedTuple):
    """Balls that together hold a part: what tells fast that a tile cannot see it. b rows."""

    part: IntArray  # (b,) rows of one part are neighbours
    along: Array  # (b,) place on the axis of a capsule, -1 .. 1 half lengths
    share: Array  # (b,) half of the axis that the ball covers, in half lengths
    p_W: Array  # (b, 3) posed
    radius: Array  # (b,) posed [m]


class Hall(NamedTuple):
    """The room, seen from inside; its faces are one-sided."""

    low: Array  # (3,) [m]
    high: Array  # (3,) [m]
    face: IntArray  # (6,) textures
    period: Array  # (6,) length of one period [m]
    light: Array  # (6,) how bright each face is lit
    opening: int  # texture of the openings in the ceiling: 1 where the sky shows
    detail: int  # texture of the grain that shows near by
    detail_per_m: float  # its periods per metre
    clouds: int


class Bundle(NamedTuple):
    """Rays that start in one place, and what is known of each. Codes of hits are the kernels'."""

    ray: Array  # (3, k) unit, W axes
    pixel: Array  # (k,) angle that the ray stands for [rad]
    range: Array  # (k,) distance to the first hit [m]
    hit: IntArray  # (k,) -1 nothing, 0..5 faces of the room, 6 and on parts
    grey: Grey  # (k,)
    light: Grey  # (k,) that falls on what it met
    spots: Spots  # where on its texture
    patches: Patches  # and on which
    grain: Patches  # the room's grain for all, ...
    opening: Patches  # ... and the openings in its ceiling
    fine: Grey  # (k,) samples of either
    work: Reading


class SceneArrays(NamedTuple):
    """All that the kernels read."""

    parts: Parts
    objects: Objects
    balls: Balls
    hall: Hall
    atlas: Atlas
    sun: Array  # (3,) unit, towards the sun
