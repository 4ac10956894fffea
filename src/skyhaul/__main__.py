# SPDX-License-Identifier: Apache-2.0
"""`python -m skyhaul`."""

import sys

from skyhaul.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
