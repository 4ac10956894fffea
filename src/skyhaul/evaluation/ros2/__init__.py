# SPDX-License-Identifier: Apache-2.0
"""ROS 2 messages: definitions as .msg texts and their CDR encoding."""
