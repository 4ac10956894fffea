# SPDX-License-Identifier: Apache-2.0
"""Calibration files: EuRoC's `sensor.yaml` of each sensor, Kalibr's camera chain and IMU.

The body of the data set is the IMU, as in EuRoC: T_BS takes points of a sensor into IMU axes,
the ground truth is the IMU's pose.
"""

import re
from typing import Any

import numpy as np
import yaml

from skyhaul.geometry.camera import CameraModel
from skyhaul.sensors.api import (
    CameraCalibration,
    ImuCalibration,
    RigCalibration,
    TagCalibration,
    VehicleCalibration,
)
from skyhaul.types import US_PER_S, Array


def plain(name: str) -> str:
    """A camera's name as part of a topic or a frame."""
    return re.sub(r"\W+", "_", name)


def T_IC(imu: ImuCalibration, camera: CameraCalibration) -> Array:
    """Pose of a camera in the IMU's axes, (4, 4)."""
    T = np.eye(4)
    T[:3, :3] = imu.R_BI.T @ camera.R_BC
    T[:3, 3] = imu.R_BI.T @ (camera.p_BC - imu.p_BI)
    return T


def inverse(T: Array) -> Array:
    """Inverse of a pose, (4, 4)."""
    out = np.eye(4)
    out[:3, :3] = T[:3, :3].T
    out[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return out


def camera_yaml(imu: ImuCalibration, camera: CameraCalibration) -> str:
    """EuRoC's description of a camera."""
    model = "radial-tangential" if camera.model.kind == "radtan" else "equidistant"
    return _dump(
        {
            "sensor_type": "camera",
            "comment": camera.name,
            "T_BS": _matrix(T_IC(imu, camera)),
            "rate_hz": camera.rate_hz,
            "resolution": list(camera.model.size_px),
            "camera_model": "pinhole",
            "intrinsics": _intrinsics(camera.model),
            "distortion_model": model,
            "distortion_coefficients": list(camera.model.distortion),
            "timeshift_cam_imu": imu.clock_offset_us / US_PER_S,
        }
    )


def imu_yaml(imu: ImuCalibration, comment: str) -> str:
    """EuRoC's description of an IMU."""
    return _dump(
        {
            "sensor_type": "imu",
            "comment": comment,
            "T_BS": _matrix(np.eye(4)),
            "rate_hz": imu.rate_hz,
            "gyroscope_noise_density": imu.gyro_noise,
            "gyroscope_random_walk": imu.gyro_walk,
            "accelerometer_noise_density": imu.accel_noise,
            "accelerometer_random_walk": imu.accel_walk,
        }
    )


def truth_yaml() -> str:
    """EuRoC's description of the ground truth."""
    return _dump(
        {
            "sensor_type": "visual-inertial",
            "comment": "simulated state of the IMU, exact; its clock is the true time",
            "T_BS": _matrix(np.eye(4)),
        }
    )


def body_yaml(imu: ImuCalibration, carrier: str) -> str:
    """What the body is: the IMU, and where it sits in its carrier."""
    T_BI = np.eye(4)
    T_BI[:3, :3], T_BI[:3, 3] = imu.R_BI, imu.p_BI
    return _dump(
        {
            "comment": f"the body is the IMU; T_carrier_imu: its pose in {carrier}, from the "
            "centre of mass, x forward, y left, z up; imu_clock_ahead_s: the stamp of a sample "
            "less the true time",
            "T_carrier_imu": _matrix(T_BI),
            "imu_clock_ahead_s": imu.clock_offset_us / US_PER_S,
        }
    )


def tag_yaml(tag: TagCalibration) -> str:
    """The tag on the load: which, how large, and where."""
    T_LT = np.eye(4)
    T_LT[:3, :3], T_LT[:3, 3] = tag.R_LT, tag.p_LT
    return _dump(
        {
            "comment": "edge_m: of the black square; T_payload_tag: the tag's pose in the load, "
            "from its centre of mass; the tag's x right, y up, z towards who reads it",
            "family": tag.family,
            "id": tag.id,
            "edge_m": tag.edge_m,
            "T_payload_tag": _matrix(T_LT),
        }
    )


def all_cameras(rig: RigCalibration) -> list[CameraCalibration]:
    """The cameras of a rig, the event camera last."""
    return [*rig.cameras, *([rig.event_camera] if rig.event_camera else [])]


def kalibr_cameras(known: VehicleCalibration, topics: list[str]) -> str:
    """Kalibr's `camchain-imucam.yaml`; the event camera comes last, after the cameras.

    Args:
        known: The vehicle's sensors.
        topics: Of each camera, the event camera last.
    """
    cameras = all_cameras(known.rig)
    poses = [T_IC(known.imu, camera) for camera in cameras]
    out: dict[str, Any] = {}
    for i, camera in enumerate(cameras):
        entry: dict[str, Any] = {"T_cam_imu": inverse(poses[i]).tolist()}
        if i:
            entry["T_cn_cnm1"] = (inverse(poses[i]) @ poses[i - 1]).tolist()
        entry |= {
            "camera_model": "pinhole",
            "intrinsics": _intrinsics(camera.model),
            "distortion_model": camera.model.kind,
            "distortion_coeffs": list(camera.model.distortion),
            "resolution": list(camera.model.size_px),
            "rostopic": topics[i],
            "timeshift_cam_imu": known.imu.clock_offset_us / US_PER_S,
        }
        out[f"cam{i}"] = entry
    return _dump(out)


def kalibr_imu(imu: ImuCalibration, topic: str) -> str:
    """Kalibr's `imu.yaml`."""
    return _dump(
        {
            "accelerometer_noise_density": imu.accel_noise,
            "accelerometer_random_walk": imu.accel_walk,
            "gyroscope_noise_density": imu.gyro_noise,
            "gyroscope_random_walk": imu.gyro_walk,
            "rostopic": topic,
            "update_rate": float(imu.rate_hz),
        }
    )


def _intrinsics(model: CameraModel) -> list[float]:
    return [*model.focal_px, *model.center_px]


def _matrix(T: Array) -> dict[str, Any]:
    return {"cols": 4, "rows": 4, "data": T.ravel().tolist()}


class _Dumper(yaml.SafeDumper):
    """Matrices a row a line, rows on one line, mappings spread out."""


def _list_node(dumper: yaml.SafeDumper, data: list[Any]) -> yaml.Node:
    nested = any(isinstance(v, list | dict) for v in data)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=not nested)


_Dumper.add_representer(list, _list_node)


def _dump(tree: dict[str, Any]) -> str:
    return str(yaml.dump(tree, Dumper=_Dumper, sort_keys=False, width=1000))
