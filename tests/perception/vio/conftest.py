# SPDX-License-Identifier: Apache-2.0
"""Made-up flights come from the benchmarks."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[3] / "benchmarks"))
