# SPDX-License-Identifier: Apache-2.0
"""Event cameras: which events belong to things that move by themselves."""
