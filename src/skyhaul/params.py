# SPDX-License-Identifier: Apache-2.0
"""Base of every parameter class."""

from typing import ClassVar


class Params:
    """Marks a frozen dataclass as loadable from YAML; unknown keys are errors."""

    __pydantic_config__: ClassVar = {"extra": "forbid", "allow_inf_nan": False}
