# SPDX-License-Identifier: Apache-2.0
"""Multi-quadrotor cable-suspended transport."""
