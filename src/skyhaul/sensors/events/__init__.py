# SPDX-License-Identifier: Apache-2.0
"""Event cameras: pixels that report changes of light, and renderings just often enough."""
