# SPDX-License-Identifier: Apache-2.0
"""The kinds of path search. A new one adds its entry here and in its contract test."""

from skyhaul.planning.astar import AStar
from skyhaul.planning.dijkstra import Dijkstra

PathSearch = AStar | Dijkstra
"""What a reference planner can search its paths with."""
