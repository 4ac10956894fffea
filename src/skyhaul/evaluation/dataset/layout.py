# SPDX-License-Identifier: Apache-2.0
"""Names in a data set, and files that are whole or not there."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from skyhaul.errors import FileError

FLIGHT, TRACK, MANIFEST, LOG = "flight", "truth.npz", "record.json", "log.mcap"
PAYLOAD, TAG = "payload", "tag.yaml"
DATA = "data.csv"
SENSOR = "sensor.yaml"
TRUTH = "state_groundtruth_estimate0"
KALIBR_CAMERAS, KALIBR_IMU = "camchain-imucam.yaml", "imu.yaml"
EVENTS_H5, EVENTS_TXT, LABELS_H5 = "events.h5", "events.txt", "events_labels.h5"

CAMERA_HEAD = "#timestamp [ns],filename"
IMU_HEAD = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
)
TRUTH_HEAD = (
    "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], "
    "q_RS_z [], v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1], "
    "b_w_RS_S_y [rad s^-1], b_w_RS_S_z [rad s^-1], b_a_RS_S_x [m s^-2], b_a_RS_S_y [m s^-2], "
    "b_a_RS_S_z [m s^-2]"
)
LOAD_CELL_HEAD = "#timestamp [ns],tension [N]"
"""First lines; those of EuRoC where it has the file."""


def body_name(vehicle: int | None) -> str:
    """Folder of a vehicle, or of the load."""
    return PAYLOAD if vehicle is None else f"vehicle_{vehicle}"


def partial(path: Path) -> Path:
    """Where a file or folder is made before it gets its name."""
    return path.with_name(path.name + ".part")


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn what the disk refuses into one sentence.

    Raises:
        FileError: When the system fails to write.
    """
    try:
        yield
    except OSError as fault:
        where = fault.filename or path
        # HDF5 says more than a line
        why = os.strerror(fault.errno) if fault.errno else str(fault).splitlines()[0]
        raise FileError(f"{where} cannot be written: {why}") from fault


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other recordings out of a folder meanwhile; it is made if it is not there.

    The system lets go of the lock when the process ends, however it ends.

    Raises:
        FileError: When another recording works in it, or it is no folder.
    """
    if folder.exists() and not folder.is_dir():
        raise FileError(f"--out {folder}: is a file; give a folder")
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        handle = _open_lock(folder)
    try:
        if not _take(handle):
            raise FileError(
                f"--out {folder}: another recording works in it; wait for it or give another folder"
            )
        yield
    finally:
        os.close(handle)


if sys.platform == "win32":
    import msvcrt

    def _open_lock(folder: Path) -> int:
        """A file beside the folder, for Windows opens and locks only files; it stays."""
        beside = folder.with_name(folder.name + ".lock")
        return os.open(beside, os.O_RDWR | os.O_CREAT)

    def _take(handle: int) -> bool:
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True

else:
    import fcntl

    def _open_lock(folder: Path) -> int:
        return os.open(folder, os.O_RDONLY)

    def _take(handle: int) -> bool:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True
