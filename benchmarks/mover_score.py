# SPDX-License-Identifier: Apache-2.0
"""Tracks of a flight against the truth: who was found, when, how well, and for how long."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from mover_truth import LOOK_US, Seen

from skyhaul.perception.api import Track
from skyhaul.sensors.truth_track import TruthTrack
from skyhaul.types import US_PER_S, Array, IntArray

PIXELS = 12
NEAR_M, LATEST_M = 3.0, 2.0
BAND_M = 0.5
"""Errors at 3 m are those between 2.5 and 3.5 m."""
PLACED_M = 0.5
APART_M, APART_RAD = 1.0, 0.26
PLANT_US = 2_000


@dataclass(frozen=True, eq=False)
class Followed:
    """What the estimator handed out at one step."""

    row: int  # of the truth
    tracks: tuple[Track, ...]


@dataclass(frozen=True, eq=False)
class Ways:
    """True movers, the m rows of the scenario's obstacles."""

    p: Array  # (k, m, 3) [m]
    v: Array  # (k, m, 3) [m/s]

    def at(self, t_us: float, start_us: int) -> int:
        """Row of a time."""
        return int(np.clip(round((t_us - start_us) / PLANT_US), 0, len(self.p) - 1))


def ways(truth: TruthTrack, movers: dict[int, int]) -> Ways:
    """Of the movers alone."""
    rows = list(movers.values())
    return Ways(truth.p_WO[:, rows], truth.v_WO[:, rows])


def score(
    steps: list[Followed], truth: TruthTrack, movers: dict[int, int], seen: Seen
) -> dict[str, Any]:
    """All figures of one flight; lists hold one entry per sample."""
    way = ways(truth, movers)
    k, m = seen.pixels.shape[0], len(movers)
    found = np.zeros((k, m), np.bool_)  # the mover is inside the tube of a confirmed track
    placed = np.full((k, m), -1, np.int64)  # name of the confirmed track that is where it is
    errors: list[dict[str, float]] = []
    held, false = [], {}
    for step in steps:
        a = min(step.row * PLANT_US // LOOK_US, k - 1)
        for track in step.tracks:
            row = way.at(track.stamp_us, truth.start_us)
            off = np.linalg.norm(way.p[row] - track.p_WO, axis=1)
            b = int(np.argmin(off))
            inside = off <= track.tube_m(0.0)
            found[a] |= inside
            if not inside.any() and off[b] > 1.0:
                false.setdefault(track.track_id, []).append(step.row)
                continue
            if off[b] <= PLACED_M:
                placed[a, b] = track.track_id
            speed_off = float(np.linalg.norm(way.v[row, b] - track.v_WO))
            cameras = int(np.sum(seen.pixels[max(a - 25, 0) : a + 1, :, b].max(axis=0) >= PIXELS))
            errors.append({
                "clearance_m": float(seen.clearance[a, b]), "p_m": float(off[b]),
                "v_mps": speed_off, "cameras": cameras, "mover": b,
            })  # fmt: skip
            if step.row % 50 == 0:
                held.append(_holds(track, way, truth, b))
    return {
        "approaches": approaches(found, placed >= 0, seen),
        "latency_ms": latencies(found, way, seen, first_s=0.1),
        "latency_placed_ms": latencies(placed >= 0, way, seen, first_s=0.1),
        "near": [e for e in errors if abs(e["clearance_m"] - NEAR_M) <= BAND_M],
        "switches": switches(placed, truth, way, seen),
        "tube_held": [h for h in held if h is not None],
        "coverage": coverage(seen),
        "false_tracks": len(false),
        "false_track_s": sum(len(v) for v in false.values()) * 0.01,
        "duration_s": len(truth) * PLANT_US / US_PER_S,
    }


def _holds(track: Track, way: Ways, truth: TruthTrack, b: int) -> bool | None:
    """Whether the mover stays in the track's tube over the next second; None at the end."""
    if track.stamp_us + US_PER_S > truth.start_us + PLANT_US * (len(truth) - 1):
        return None
    for ahead_s in np.linspace(0.0, 1.0, 11):
        row = way.at(track.stamp_us + ahead_s * US_PER_S, truth.start_us)
        off = np.linalg.norm(way.p[row, b] - track.p_WO - ahead_s * track.v_WO)
        if off > track.tube_m(float(ahead_s)):
            return False
    return True


def approaches(found: Array, placed: Array, seen: Seen) -> list[dict[str, Any]]:
    """One row for each time that a mover comes within 3 m: seen before? confirmed by 2 m?"""
    out = []
    visible = (seen.pixels >= PIXELS).any(axis=1)
    for b in range(found.shape[1]):
        near = seen.clearance[:, b] < NEAR_M
        begins = np.flatnonzero(near[1:] & ~near[:-1]) + 1
        for begin in begins.tolist():
            after = np.flatnonzero(~near[begin:])
            end = begin + int(after[0]) if len(after) else len(near)
            before = max(begin - 150, 0)
            close = np.flatnonzero(seen.clearance[begin:end, b] < LATEST_M)
            by = begin + int(close[0]) if len(close) else end - 1
            least = float(seen.clearance[begin:end, b].min())
            out.append({
                "mover": b, "at_s": begin * LOOK_US / US_PER_S, "least_m": least,
                "counts": bool(visible[before:begin, b].any()),
                "found": bool(found[before:by, b][-5:].any()),
                "placed": bool(placed[before:by, b][-5:].any()),
                "found_m": _first_m(found[before:end, b], seen.clearance[before:end, b]),
                "placed_m": _first_m(placed[before:end, b], seen.clearance[before:end, b]),
            })  # fmt: skip
    return out


def _first_m(which: Array, clearance: Array) -> float | None:
    at = np.flatnonzero(which)
    return float(clearance[at[0]]) if len(at) else None


def latencies(found: Array, way: Ways, seen: Seen, first_s: float) -> list[float | None]:
    """From the moment a mover covers 12 px in some camera until it is found [ms]; None: never."""
    visible = (seen.pixels >= PIXELS).any(axis=1)
    quiet = round(0.5 * US_PER_S / LOOK_US)
    out: list[float | None] = []
    for b in range(found.shape[1]):
        moving = np.linalg.norm(way.v[seen.row, b], axis=1) > 0.1
        for a in np.flatnonzero(visible[1:, b] & ~visible[:-1, b]).tolist():
            a += 1
            if a * LOOK_US < first_s * US_PER_S or visible[max(a - quiet, 0) : a, b].any():
                continue
            if not moving[a] or a + quiet >= len(moving):
                continue
            if not visible[a : a + 10, b].all():
                continue  # a glimpse of less than 0.2 s
            late = np.flatnonzero(found[a:, b])
            out.append(float(late[0]) * LOOK_US / 1000.0 if len(late) else None)
    return out


def switches(placed: IntArray, truth: TruthTrack, way: Ways, seen: Seen) -> int:
    """How often a well-separated mover goes on under another name within a second."""
    count = 0
    team = truth.p_WL[seen.row]
    p = way.p[seen.row]
    for b in range(placed.shape[1]):
        others = [c for c in range(placed.shape[1]) if c != b]
        ray = p - team[:, None]
        ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
        apart = np.ones(len(p), np.bool_)
        for c in others:
            apart &= np.linalg.norm(p[:, b] - p[:, c], axis=1) > APART_M
            apart &= np.arccos(np.clip(np.sum(ray[:, b] * ray[:, c], axis=1), -1, 1)) > APART_RAD
        last, at = -1, -1000
        for a in np.flatnonzero((placed[:, b] >= 0) & apart).tolist():
            if last >= 0 and placed[a, b] != last and (a - at) * LOOK_US <= US_PER_S:
                count += 1
            last, at = int(placed[a, b]), a
    return count


def coverage(seen: Seen) -> dict[str, int]:
    """Looks at movers within 4 m: how many, with one camera, with two that see 12 px."""
    near = seen.clearance < 4.0
    cameras = np.sum(seen.pixels >= PIXELS, axis=1)
    return {
        "looks": int(near.sum()),
        "one": int((near & (cameras >= 1)).sum()),
        "two": int((near & (cameras >= 2)).sum()),
    }
