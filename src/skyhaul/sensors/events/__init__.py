# SPDX-License-Identifier: Apache-2.0
"""Event cameras: pixels that report changes of light, and renderings just often enough."""

from skyhaul.sensors.events.pixels import EventPixels, PixelMemory

__all__ = ["EventPixels", "PixelMemory"]
