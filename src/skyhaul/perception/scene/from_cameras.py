# SPDX-License-Identifier: Apache-2.0
"""`kind: cameras`: what stands and what moves, from the stereo pairs of the whole team."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from skyhaul.model.team import Team
from skyhaul.params import Params
from skyhaul.perception.api import ObstacleEstimate, StandingVoxels, Track
from skyhaul.perception.obstacles.api import Bearings, TeamViews, VehicleView
from skyhaul.perception.obstacles.births import BirthRules
from skyhaul.perception.obstacles.motion import KalmanFilter
from skyhaul.perception.obstacles.tracker import BearingTracker, TrackerMemory
from skyhaul.perception.scene.backdrop import BackdropRules, BackdropWatch, Shot
from skyhaul.perception.scene.evidence import Evidence, clear_ball, empty_evidence, forget_changes
from skyhaul.perception.scene.stereo import StereoParams
from skyhaul.perception.scene.watch import SceneWatch, ViewRules
from skyhaul.sensors.api import VehicleCalibration
from skyhaul.types import US_PER_S, Array, IntArray, TimeUs


@dataclass(frozen=True, eq=False)
class SceneMemory:
    """What the estimator remembers; the evidence is changed in place."""

    evidence: Evidence
    tracker: TrackerMemory
    voxels: StandingVoxels
    frame: int = 0
    tracked_us: TimeUs = 0
    drawn_us: TimeUs = 0  # when `voxels` were made
    seen: tuple[Bearings, ...] = ()  # since the tracker's last step
    tracks: tuple[Track, ...] = ()
    shots: Mapping[tuple[int, int], Shot] = field(default_factory=dict)
    """The last image of each vehicle and camera outside the pairs."""


@dataclass(frozen=True, eq=False)
class TeamScene:
    """The estimator at work; implements `ObstacleEstimator`.

    Images are read as they come, the tracker steps once all vehicles have had their turn. Pairs
    give voxels and bearings with ranges, the other cameras bearings of what hides the room.
    """

    params: "CameraObstacles"
    watches: tuple[SceneWatch, ...]  # by vehicle
    backdrops: Mapping[tuple[int, int], BackdropWatch]  # by vehicle and camera
    p_WO: Array  # (3,) centre of voxel (0, 0, 0) [m]
    voxel_m: float
    cells: IntArray  # (3,)

    @property
    def pair(self) -> tuple[int, int]:
        """Left and right camera, by index in the rig."""
        return self.watches[0].pair.index

    def init(self) -> SceneMemory:
        """See `ObstacleEstimator.init`."""
        evidence = empty_evidence(self.p_WO.copy(), self.voxel_m, self.cells)
        nothing = StandingVoxels(
            evidence.occupied.copy(), self.p_WO.copy(), self.voxel_m, 0, evidence.changed.copy()
        )
        return SceneMemory(evidence, self.params.tracker.init(), nothing)

    def step(self, memory: SceneMemory, reading: TeamViews) -> tuple[SceneMemory, ObstacleEstimate]:
        """See `ObstacleEstimator.step`; it moves the evidence on in place."""
        m, now = memory, reading.stamp_us
        for view in reading.vehicles:
            bearings, _ = self.watches[view.vehicle].step(
                m.evidence, m.frame, reading.team, reading.attached, view, m.tracks
            )
            m = replace(m, frame=m.frame + 1, seen=(*m.seen, bearings))
            m = self._look_behind(m, reading, view)
        if now - m.tracked_us >= self.params.period_us and m.seen:
            m = self._track(m, now)
        changed = m.evidence.changed
        if np.all(changed[0] < changed[1]) and now - m.drawn_us >= self.params.voxel_period_us:
            m = replace(m, voxels=self._voxels(m), drawn_us=now)
        return m, ObstacleEstimate(now, (), m.tracks, m.voxels)

    def _look_behind(self, m: SceneMemory, reading: TeamViews, view: VehicleView) -> SceneMemory:
        """Compare the images of the other cameras with the room."""
        shots, seen = dict(m.shots), list(m.seen)
        for camera, image in view.others:
            key = (view.vehicle, camera)
            if key not in self.backdrops:
                continue
            shots[key], bearings = self.backdrops[key].step(
                shots.get(key), view.stamp_us, image, reading.team, reading.attached,
                view.pose_covariance, m.evidence,
            )  # fmt: skip
            seen.append(bearings)
        return replace(m, shots=shots, seen=tuple(seen))

    def _track(self, m: SceneMemory, now: TimeUs) -> SceneMemory:
        seen = tuple(replace(b, age_s=b.age_s + (now - b.stamp_us) / US_PER_S) for b in m.seen)
        tracker, tracks = self.params.tracker.step(m.tracker, now, seen)
        known = {t.track_id for t in m.tracks}
        for t in tracks:
            if t.track_id not in known:  # what it left behind before it was known to move
                radius = t.shape.radius_m if t.shape.kind == "sphere" else 0.0
                radius += self.params.view.track_margin_m
                clear_ball(self.params.view.evidence, m.evidence, t.p_WO, radius)
        return replace(m, tracker=tracker, tracks=self._useful(tracks), tracked_us=now, seen=())

    def _useful(self, tracks: tuple[Track, ...]) -> tuple[Track, ...]:
        """Those whose place is known, their tubes growing no faster than can be planned with."""
        p = self.params
        return tuple(
            replace(t, growth_mps=min(t.growth_mps, p.growth_most_mps))
            for t in tracks
            if t.tube_base_m <= p.tube_most_m
        )

    def _voxels(self, m: SceneMemory) -> StandingVoxels:
        e, old = m.evidence, m.voxels
        new = StandingVoxels(
            e.occupied.copy(), old.p_WO, old.voxel_m, old.version + 1, e.changed.copy()
        )
        forget_changes(e)
        return new


def _tracker() -> BearingTracker:
    return BearingTracker(
        filter=KalmanFilter(models="velocity", manoeuvre=0.005, speed_sigma_mps=0.7),
        confirm_hits=3,
        confirm_steps=4,
        confirm_alone=4,
        births=BirthRules(pairs=False, radius_spread=0.0),
        coast_s=1.5,
    )


@dataclass(frozen=True, kw_only=True)
class CameraObstacles(Params):
    """How depth becomes voxels and tracks."""

    kind: Literal["cameras"] = "cameras"
    stereo: StereoParams = field(default_factory=StereoParams)
    """From images to depth."""
    view: ViewRules = field(default_factory=ViewRules)
    """From depth to voxels and to what moves."""
    backdrop: BackdropRules | None = None
    """How the other cameras' images are compared with the room; None: they are not looked at."""
    tracker: BearingTracker = field(default_factory=_tracker)
    """From what moves to tracks."""
    tube_most_m: float = 0.7
    """A track whose place is known no better than this is not handed out [m]."""
    growth_most_mps: float = 0.3
    """Tubes grow no faster than this: what has been seen a few times only would block the whole map
    otherwise; the next sights tell more before it comes near [m/s]."""
    period_us: TimeUs = 100_000
    """Time between two steps of the tracker: that of the images [us]."""
    voxel_period_us: TimeUs = 200_000
    """Least time between two versions of the voxels: each costs the map a new field [us]."""

    def build(
        self, team: Team, calibration: VehicleCalibration, room: Array, p_WO: Array,
        voxel_m: float, cells: IntArray,
    ) -> TeamScene:  # fmt: skip
        """The estimator of a team whose vehicles carry equal sensors.

        Args:
            team: Its bodies, which are not obstacles.
            calibration: Of every vehicle's sensors.
            room: Smallest and largest corner, (2, 3) [m].
            p_WO: Centre of voxel (0, 0, 0) of the map, (3,) [m].
            voxel_m: Edge of a voxel [m].
            cells: Size of the map in voxels, (3,).

        Raises:
            ConfigError: When the rig has no stereo pair.
        """
        pair = self.stereo.build(calibration.rig)
        watches = tuple(SceneWatch(i, team, pair, self.view, room) for i in range(team.count))
        others = [k for k in range(len(calibration.rig.cameras)) if k not in pair.index]
        rules = self.backdrop
        backdrops = {} if rules is None else {
            (i, k): BackdropWatch(
                rules, i, (1 + others.index(k)) * team.count + i, team,
                calibration.rig.cameras[k], room,
            )
            for i in range(team.count)
            for k in others
        }  # fmt: skip
        return TeamScene(self, watches, backdrops, p_WO, voxel_m, cells)
