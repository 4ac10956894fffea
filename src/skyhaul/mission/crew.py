# SPDX-License-Identifier: Apache-2.0
"""All agents of a flight in one process, and which of them leads."""

from skyhaul.comms.api import Bus
from skyhaul.mission.api import Recorder
from skyhaul.mission.leader import Leader
from skyhaul.mission.setup import Stack
from skyhaul.mission.stopwatch import Stopwatch
from skyhaul.mission.tracking import SharedTracking
from skyhaul.mission.vehicle import VehicleAgent
from skyhaul.perception.api import TeamEstimate
from skyhaul.types import TimeUs


class Crew:
    """The agents, and the leader's role, held by the lowest vehicle that is not faulty."""

    def __init__(self, stack: Stack, bus: Bus, recorder: Recorder, watch: Stopwatch) -> None:
        n = stack.team.count
        tracking = SharedTracking(stack.vehicle_control, n)
        self.agents = [VehicleAgent(i, stack, bus, tracking) for i in range(n)]
        self.leader = Leader(stack, 0, bus, recorder, watch)

    def communicate(self, t_us: TimeUs, estimate: TeamEstimate) -> Leader:
        """Exchange messages; returns the leader, who may have changed."""
        heard = [agent.hear(t_us) for agent in self.agents]
        own = [agent.report(t_us, estimate) for agent in self.agents]
        chief = self.agents[self._elected()]
        if chief.index != self.leader.index:
            self.leader.take_over(chief.index, chief.plan)
        statuses = [s for s in (*heard[chief.index], own[chief.index]) if s is not None]
        self.leader.hear(t_us, statuses, chief.faulty)
        return self.leader

    def tell_leading_vehicle(self) -> None:
        """The leader's own vehicle hears its orders and plans without the bus."""
        agent = self.agents[self.leader.index]
        agent.order, agent.plan = self.leader.order, self.leader.forces.message

    def _elected(self) -> int:
        """Lowest vehicle that does not know itself to be faulty; the old leader if all are."""
        for agent in self.agents:
            if agent.index not in agent.faulty:
                return agent.index
        return self.leader.index
