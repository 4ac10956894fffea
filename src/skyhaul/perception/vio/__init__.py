# SPDX-License-Identifier: Apache-2.0
"""Visual-inertial odometry: the state of one vehicle from its cameras and its IMU."""
