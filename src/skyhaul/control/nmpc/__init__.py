# SPDX-License-Identifier: Apache-2.0
"""Payload NMPC: `Nmpc` decides every cable force, `WrenchNmpc` the paper's wrench."""

from skyhaul.control.nmpc.controller import NmpcMemory, PayloadNmpc
from skyhaul.control.nmpc.params import Nmpc, WrenchNmpc

__all__ = ["Nmpc", "NmpcMemory", "PayloadNmpc", "WrenchNmpc"]
