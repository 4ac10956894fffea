# SPDX-License-Identifier: Apache-2.0
"""Recordings of sensors as files that other tools read."""
