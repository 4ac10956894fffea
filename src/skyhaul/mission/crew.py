# SPDX-License-Identifier: Apache-2.0
"""All agents of a flight in one process, and which of them leads."""

from skyhaul.comms.api import Bus
from skyhaul.comms.messages import ORDER, PLAN
from skyhaul.comms.repeat import RepeatingBus
from skyhaul.mission.api import Recorder
from skyhaul.mission.leader import Leader
from skyhaul.mission.setup import Stack
from skyhaul.mission.stopwatch import Stopwatch
from skyhaul.mission.tracking import SharedTracking
from skyhaul.mission.vehicle import STATUS_PERIOD_US, VehicleAgent
from skyhaul.perception.api import TeamEstimate
from skyhaul.types import TimeUs


class Crew:
    """The agents, and the leader's role, held by the lowest vehicle that is heard and not faulty.

    Every agent elects by what it hears itself, and the role goes to one that elects itself: where
    the vehicle that led so far is cut off and does not know it yet, to the newer one. The leader's
    orders and plans are sent until every vehicle that carries has them.
    """

    def __init__(self, stack: Stack, bus: Bus, recorder: Recorder, watch: Stopwatch) -> None:
        n = stack.team.count
        tracking = SharedTracking(stack.vehicle_control, n)
        self.agents = [VehicleAgent(i, stack, bus, tracking) for i in range(n)]
        self._orders = RepeatingBus(bus)
        self.leader = Leader(stack, 0, self._orders, recorder, watch)
        self._faulty: frozenset[int] = frozenset()
        self._claims = frozenset({0})

    def communicate(self, t_us: TimeUs, estimate: TeamEstimate) -> Leader:
        """Exchange messages; returns the leader, who may have changed."""
        heard = [agent.hear(t_us) for agent in self.agents]
        own = [agent.report(t_us, estimate) for agent in self.agents]
        chief = self.agents[self._elected()]
        if chief.index != self.leader.index:
            self._orders.forget()
            self.leader.take_over(t_us, chief.index, chief.order, chief.plan)
        statuses = [s for s in (*heard[chief.index], own[chief.index]) if s is not None]
        for status in statuses:
            held = {ORDER: status.order_us, PLAN: status.plan_us}
            self._orders.confirm(status.vehicle, held)
        if statuses or chief.faulty != self._faulty:
            self.leader.hear(t_us, statuses, chief.faulty)
            self._faulty = chief.faulty
        if t_us % STATUS_PERIOD_US == 0:
            carrying = [a.index for a in self.agents if a.index not in chief.faulty]
            self._orders.repeat(t_us, chief.index, carrying)
        return self.leader

    def tell_leading_vehicle(self) -> None:
        """The leader's own vehicle hears its orders and plans without the bus."""
        agent = self.agents[self.leader.index]
        agent.order = self.leader.order
        agent.plan = self.leader.forces.message or agent.plan  # its own while none is made yet

    def _elected(self) -> int:
        """The vehicle that began to elect itself last; the old leader while none does."""
        claims = frozenset(agent.index for agent in self.agents if agent.chief == agent.index)
        new, self._claims = claims - self._claims, claims
        leader = self.leader.index
        stays = not claims or (leader in claims and not new)
        return leader if stays else min(new or claims)
