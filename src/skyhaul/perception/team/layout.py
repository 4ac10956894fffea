# SPDX-License-Identifier: Apache-2.0
"""State of the team's filter as the kernels see it, and the parameters they take.

Error of the state, (15 + 9 n,):

    load        p 0:3 [m], turn 3:6 [rad], v 6:9 [m/s], gyro bias 9:12, accelerometer bias 12:15
    vehicle i   at 15 + 9 i: p of its frame 0:3 [m], turn of its frame 3:6 [rad], force bias 6:9 [N]

The load's p and v are those of its IMU in W, its turn and biases are in L axes (right tangent). A
vehicle's odometry lives in a frame of its own that drifts: p_WI = p_VI + p, R_WI = Exp(turn) R_VI,
turn in W axes. The force bias, B axes, is what thrust scale and accelerometer bias add to
m s - f e_3.
"""

from typing import NamedTuple

from skyhaul.geometry.camera import CameraArrays
from skyhaul.jit import njit
from skyhaul.types import Array

LOAD_NE, VEHICLE_NE = 15, 9
NAV_NX = 16
"""Columns of a pose and motion: p 0:3, q 3:7, v 7:10, gyro bias 10:13, accelerometer bias 13:16."""
KEPT = 64
"""IMU samples of each vehicle that are kept for estimates and sights that come late."""


class FilterParams(NamedTuple):
    """What stays the same during a flight."""

    mass: Array  # (n,) of the vehicles [kg]
    length: Array  # (n,) of the cables [m]
    hook_L: Array  # (n, 3) from the load's centre of mass, L axes [m]
    load_mass: float  # [kg]
    load_J: Array  # (3,) principal inertia, L axes [kg m^2]
    drag: tuple[float, float]  # of a vehicle, of the load [N s/m]
    g: float  # [m/s^2]
    p_BI: Array  # (3,) IMU of a vehicle in B axes [m]
    R_BI: Array  # (3, 3)
    q_BI: Array  # (4,) the same turn
    p_LI: Array  # (3,) IMU of the load in L axes [m]
    dt: tuple[float, float]  # period of a vehicle's and of the load's IMU [s]
    load_noise: Array  # (4,) densities: gyro, accelerometer, and the walks of their biases
    camera: CameraArrays  # the down camera
    p_IC: Array  # (3,) down camera in the axes of the vehicle's IMU [m]
    R_IC: Array  # (3, 3)
    corners_L: Array  # (4, 3) of the tag, from the load's IMU, L axes [m]
    sigma_px: float
    sigma_length: float  # [m]
    sigma_direction: float  # of the cable force's direction over a window [rad]
    sigma_force: float  # of the sum of cable forces over a window [N]
    sigma_moment: float  # of their moment over a window [N m]
    force_walk: float  # of the force bias [N/sqrt(s)]
    tilt_time: float  # roll and pitch errors of odometry are correlated this long [s]
    frame_walk: tuple[float, float]  # least walk of a frame: p [m/sqrt(s)], yaw [rad/sqrt(s)]
    taut_force: float  # a cable that pulls more is taut [N]
    slack_force: float  # a cable that pulls less is slack [N]
    slack_length: float  # a cable shorter by this is slack [m]


class FilterState(NamedTuple):
    """Everything that a step changes. Times are microseconds in a float: exact for 285 years."""

    load: Array  # (16,) pose and motion of the load's IMU in W, L axes
    load_last: Array  # (9,) last rate and force without bias, L axes; angular acceleration
    load_us: Array  # (4,) time of `load`; highest z of rest [m]; still for [s]; samples so far
    nav: Array  # (n, 16) pose and motion of the vehicles' IMUs in their odometry's frames
    nav_last: Array
    """(n, 12) last rate without bias 0:3, angular acceleration 3:6, specific force at the centre of
    mass 6:9, all B axes; thrust over the last sample 9, hook closed 10, last thrust 11."""
    vio: Array  # (n, 4) p of the last estimate, its time (-1: none yet)
    vio_cov: Array  # (n, 6, 6) of its pose: p, turn; W axes
    offset: Array  # (n, 9) p, turn, force bias
    P: Array  # (15 + 9 n, 15 + 9 n)
    past: Array  # (n, KEPT, 7) time at the end of the sample, rate, force, I axes; ring
    head: Array  # (n,) samples so far, those made up included
    made_up: Array  # (n,) samples made up since the last that came
    waiting: Array  # (n + 1, 7) as `past`, samples that must be borne out, time -1: none; load last
    window: Array  # (n, 8) sums: force in V axes 0:3, direction 3:6, samples, off the floor
    balance: Array  # (n, 4) sums since the load's last sample: force in V axes, samples
    sums: Array  # (7,) force and moment left over, W and L axes; samples
    taut: Array  # (n, 3) 1 where taut; filtered tension; height at the start
    tally: Array  # (4,) sights taken, sights refused, refused in a row, other updates refused


@njit
def copied(s: FilterState) -> FilterState:
    """The same state in arrays of its own."""
    return FilterState(
        s.load.copy(), s.load_last.copy(), s.load_us.copy(), s.nav.copy(), s.nav_last.copy(),
        s.vio.copy(), s.vio_cov.copy(), s.offset.copy(), s.P.copy(), s.past.copy(),
        s.head.copy(), s.made_up.copy(), s.waiting.copy(), s.window.copy(), s.balance.copy(),
        s.sums.copy(), s.taut.copy(), s.tally.copy(),
    )  # fmt: skip
