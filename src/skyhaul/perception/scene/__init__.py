# SPDX-License-Identifier: Apache-2.0
"""What stands and what moves, from the depth that the vehicles' stereo pairs see."""
