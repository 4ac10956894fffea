# SPDX-License-Identifier: Apache-2.0
"""The `skyhaul` command: parse, call, print."""
