# SPDX-License-Identifier: Apache-2.0
"""The plant: MuJoCo with rotor lag, wind, obstacles, hooks, failures and true clearance."""

import mujoco
import numpy as np

from skyhaul.errors import ConfigError, DivergenceError, SkyhaulError
from skyhaul.geometry.distance import bounding_radius
from skyhaul.geometry.shapes import ShapeArrays
from skyhaul.model.envelope import team_shape
from skyhaul.model.mixer import mixer_matrix
from skyhaul.model.state import CableState, TautState, TeamState
from skyhaul.plant.api import PLANT_STEP_US, Contact, Truth
from skyhaul.plant.build import OPEN_M, build_model, place, relax, set_taut_state
from skyhaul.plant.clearance import Surroundings, room_distance, touch_memory
from skyhaul.plant.cycle import JUMP_M, drive, look, move
from skyhaul.plant.events import EventQueue
from skyhaul.plant.observe import observation, team_bodies, write_forces
from skyhaul.plant.start import start_state
from skyhaul.plant.wind import is_calm, wind_model
from skyhaul.types import US_PER_S, Array, IntArray, Mask, TimeUs, frozen
from skyhaul.world.motion import obstacle_field
from skyhaul.world.scenario import Scenario

STEP_S = PLANT_STEP_US / US_PER_S
_NO_CONTACT = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
_VELOCITY_STAGE = int(mujoco.mjtStage.mjSTAGE_VEL)


class MujocoPlant:
    """See `plant.api.Plant`. Same scenario, seed and commands: same truth, bit for bit.

    Thrust follows the rotors' lag as its mean over each step; drag acts on the velocity relative
    to the air; wind and obstacles are held over a step. Every cable but a cut one can be attached
    again. The place of a slack or open cable is a straight line for `Truth.cables`; for clearance
    an open cable does not exist.

    The pass at the end of a step, which the truth is read from, is at the state where the next
    step begins, so that step only computes anew what its inputs change.

    Limits:
        Cables have no mass, no drag and pass through each other; nothing they touch feels them.
        The wind is the same everywhere. Rotors do not stall, and know no ground effect.
    """

    def __init__(self, scenario: Scenario, seed: int) -> None:
        """Build the world of a scenario.

        Args:
            scenario: What to build.
            seed: Sets the phases of the obstacles (0: as in the file) and the turbulence.

        Raises:
            ConfigError: when the start is impossible: bodies in each other, in an obstacle or
                outside the room, cables too short; or when an event names no vehicle.
        """
        team, world = scenario.team, scenario.world
        self._team = team.arrays()
        self._mixer = mixer_matrix(team.vehicle.arm_m, team.vehicle.torque_per_thrust_m)
        self._drag = np.array(
            [team.payload.drag_ns_per_m] + team.count * [team.vehicle.drag_ns_per_m]
        )
        self._field = obstacle_field(world, seed, team_shape(team, 0.0))
        shapes = self._field.shapes
        self._reach = np.array([bounding_radius(shapes, j) for j in range(len(shapes.kind))])
        self._room = (np.array(world.room.min_m, float), np.array(world.room.max_m, float))
        self._wind = wind_model(world.wind, STEP_S)
        self._gusty = not is_calm(world.wind)
        self._air = self._wind.init(seed)

        start = start_state(scenario)
        self._model = build_model(team, world.room, self._field.shapes_at(0), self._field.names)
        self._data = mujoco.MjData(self._model)
        self._t_us: TimeUs = 0
        self._alive = np.ones(team.count, dtype=np.bool_)
        self._attached = np.full(team.count, start.attached)
        self._cut = np.zeros(team.count, dtype=np.bool_)
        self._rotors = start.rotor_thrust.copy()
        self._events = EventQueue(scenario, start.p_WL)
        for i in np.flatnonzero(~self._attached):
            self._open(int(i))
        d = self._data
        self._inputs, self._constants = (d.ctrl, d.qfrc_applied), (self._mixer, self._drag)
        self._views, self._mocap = (d.qpos, d.qvel, d.qacc), d.mocap_pos
        self._hooks_changed, self._colliding, self._alone = False, True, False
        self._masks: tuple[Mask, Mask] | None = None
        self._bodies = team_bodies(team)
        self._touches = touch_memory(team.count, len(self._field.names))
        self._present = np.full(len(shapes.kind), self._field.always)
        self._wind_W = self._wind.at(self._air, 0.0)
        frozen(self._present, self._wind_W)
        self._move_obstacles(start.p_WL.copy())
        self._write(self._rotors)
        place(self._model, d, start)
        self._check_start(self._observe())
        relax(self._model, d, start)
        self._touches.touching[:] = False
        self._truth = self._observe()

    def truth(self) -> Truth:
        """State now."""
        return self._truth

    def step(self, rotor_cmd: Array) -> Truth:
        """Advance `PLANT_STEP_US` under commanded rotor thrusts, (n, 4) [N]; clipped per rotor.

        Raises:
            DivergenceError: when the state is no longer finite.
        """
        command = np.array(rotor_cmd, dtype=np.float64)  # a copy: kernels see one type only
        if command.shape != self._rotors.shape:
            raise SkyhaulError(
                f"rotor_cmd must have shape {self._rotors.shape}, got {command.shape}"
            )
        self._play_events()
        now = (command, self._alive, self._wind_W)
        drive(tuple(self._team), self._inputs, self._constants, now, self._rotors, STEP_S)
        self._integrate()
        self._t_us += PLANT_STEP_US
        if self._gusty:
            self._wind.step(self._air)
            self._wind_W = self._wind.at(self._air, self._t_us / US_PER_S)
            frozen(self._wind_W)
        if self._move_obstacles(self._views[0][:3]) > JUMP_M:
            self._collide(True)
        mujoco.mj_forward(self._model, self._data)
        self._truth = self._observe()
        self._collide(not self._alone)
        return self._truth

    def _collide(self, wanted: bool) -> None:
        """Let MuJoCo look for contacts, or not where there can be none: the result is the same."""
        if wanted is not self._colliding:
            self._colliding = wanted
            self._model.opt.disableflags ^= _NO_CONTACT

    def _integrate(self) -> None:
        """One step of RK4: `mj_step` without the part of its first pass that is known."""
        if self._hooks_changed:
            mujoco.mj_forward(self._model, self._data)
            self._hooks_changed = False
        else:
            mujoco.mj_forwardSkip(self._model, self._data, _VELOCITY_STAGE, 1)
        mujoco.mj_RungeKutta(self._model, self._data, 4)

    def set_taut(self, state: TautState, rotor_thrust: Array) -> Truth:
        """Put the team into a taut state, cables exactly as long as they are; time goes on.

        Args:
            state: Where to put it; motion included.
            rotor_thrust: Thrusts of the rotors then, (n, 4) [N].
        """
        set_taut_state(self._model, self._data, self._team, state)
        self._rotors[:] = rotor_thrust
        self._write(self._rotors)
        self._collide(True)
        mujoco.mj_forward(self._model, self._data)
        self._truth = self._observe()
        return self._truth

    def release_hook(self, i: int) -> None:
        """Open the quick-release hook of cable i: it falls away with its vehicle."""
        self._attached[i], self._masks = False, None
        self._open(i)

    def attach_hook(self, i: int) -> bool:
        """Close hook i; False when the vehicle is farther from it than the cable is long."""
        reaches = self._truth.cables.length[i] <= self._team.length[i]
        if reaches and not self._cut[i]:
            self._attached[i], self._masks = True, None
            self._model.tendon_range[i, 1] = self._team.length[i]
            self._hooks_changed = True
        return bool(self._attached[i])

    def _open(self, i: int) -> None:
        self._model.tendon_range[i, 1] = OPEN_M
        self._hooks_changed = True

    def _play_events(self) -> None:
        for event in self._events.due(self._t_us, self._truth.team.p_WL):
            if event.kind == "vehicle-dies":
                self._alive[event.vehicle], self._masks = False, None
            else:
                self._cut[event.vehicle] |= event.kind == "cable-cut"
                self.release_hook(event.vehicle)

    def _write(self, rotor_mean: Array) -> None:
        write_forces(*self._inputs, self._mixer, rotor_mean, self._wind_W, self._drag)

    def _move_obstacles(self, p_WL: Array) -> float:
        """Obstacles to where they are now, with the load at p_WL, (3,); how far they go [m]."""
        field, m = self._field, len(self._present)
        if not field.always:
            self._present = self._present | field.present(self._t_us, p_WL.copy())
            frozen(self._present)
        p_WO, v_WO, t_s = np.empty((m, 3)), np.empty((m, 3)), self._t_us / US_PER_S
        way = move(tuple(field.motions), t_s, self._present, self._mocap, p_WO, v_WO)
        kind, size, _, R_WO = field.shapes
        self._obstacles = (ShapeArrays(kind, size, p_WO, R_WO), v_WO)
        return way

    def _observe(self) -> Truth:
        """Read MuJoCo out after a forward pass at the present state."""
        d, o = self._data, observation(len(self._alive))
        obstacles, v_WO = self._obstacles
        alive, attached = self._masks_now()
        finite, clearance, begun, self._alone = look(
            tuple(self._team),
            self._views,
            (d.efc_type, d.efc_id, d.efc_force),
            tuple(self._bodies),
            tuple(o),
            self._attached,
            tuple(obstacles),
            (self._reach, self._present, *self._room),
            tuple(self._touches),
        )
        if not finite:
            raise DivergenceError(f"the plant diverged at {self._t_us / US_PER_S:.3f} s")
        return Truth(
            stamp_us=self._t_us,
            team=TeamState(o.p_WL, o.q_WL, o.v_WL, o.w_WL_L, o.p_WB, o.q_WB, o.v_WB, o.w_WB_B),
            cables=CableState(o.dir_W, o.w_W, o.tension, o.length),
            attached=attached,
            alive=alive,
            rotor_thrust=self._rotors.copy(),
            accel_W=o.accel_W,
            obstacles=obstacles,
            v_WO=v_WO,
            present=self._present,
            wind_W=self._wind_W,
            clearance_m=clearance,
            contacts=self._contacts(self._touches.begun[:begun]) if begun else (),
        )

    def _masks_now(self) -> tuple[Mask, Mask]:
        """Which vehicles are alive and attached; the same arrays as long as none changes."""
        if self._masks is None:
            self._masks = (self._alive.copy(), self._attached.copy())
        return self._masks

    def _contacts(self, begun: IntArray) -> tuple[Contact, ...]:
        n, names = len(self._alive), self._field.names
        team = ["payload", *(f"vehicle {i}" for i in range(n)), *(f"cable {i}" for i in range(n))]
        others = [*names, "room", *team]
        return tuple(Contact(self._t_us, team[r], others[c]) for r, c in begun)

    def _check_start(self, truth: Truth) -> None:
        """Bodies are inside the room and touch only its floor; cables are in no obstacle."""
        around = Surroundings(truth.obstacles, self._reach, truth.present, *self._room)
        team = ["payload", *(f"vehicle {i}" for i in range(truth.team.n))]
        for r, name in enumerate(team):
            if room_distance(self._bodies, r, around) < -1e-6:
                raise ConfigError(f"start: {name} is not inside the room; move it or grow the room")
        for contact in truth.contacts:
            slack = contact.body_a.startswith("cable") and contact.body_b in team
            if contact.body_b != "room" and not slack:
                raise ConfigError(
                    f"start: {contact.body_a} is inside {contact.body_b} at time 0; "
                    "move one of them"
                )
