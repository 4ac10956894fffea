# SPDX-License-Identifier: Apache-2.0
"""Exceptions: wrong use of the package. Expected outcomes are values, not exceptions."""


class SkyhaulError(Exception):
    """Base of every error we raise; its text is one sentence a user can act on."""


class ConfigError(SkyhaulError):
    """A scenario or an option is malformed or impossible."""


class DivergenceError(SkyhaulError):
    """The simulated motion is no longer finite: the flight cannot go on."""


class FileError(SkyhaulError):
    """A file is missing, unreadable or of the wrong kind."""


class GeometryError(SkyhaulError):
    """An array is no rotation, no unit vector or has the wrong shape."""


class PlatformError(SkyhaulError):
    """This machine lacks something that the command needs."""


class SensorDataError(SkyhaulError):
    """Measurements are nonsense: their order, rate, unit or axes."""
