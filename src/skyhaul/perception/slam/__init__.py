# SPDX-License-Identifier: Apache-2.0
"""Places seen before: recognised, checked, and closed in a graph of poses."""
