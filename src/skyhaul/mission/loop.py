# SPDX-License-Identifier: Apache-2.0
"""Algorithm 1 of the paper, one cycle of 2 ms."""

from skyhaul.mission.crew import Crew
from skyhaul.mission.vehicle import Actuation
from skyhaul.perception.api import ObstacleEstimate, TeamEstimate
from skyhaul.types import TimeUs


def cycle(
    crew: Crew, t_us: TimeUs, estimate: TeamEstimate, obstacles: ObstacleEstimate | None
) -> list[Actuation]:
    """One cycle of the whole team; returns what each vehicle asks of its hardware.

    Args:
        crew: The agents and the leading role among them.
        t_us: Time now [us].
        estimate: p(t), from perception.
        obstacles: o(t), when perception has news; None between.

    Source:
        Paper, Algorithm 1.

    Deviation:
        The paper searches a path in every cycle and then asks for events (PAPER_NOTES 12), and
        applies every input of the horizon open loop (11). Here an event comes first, and the
        vehicles follow the plan with feedback until the next one.
    """
    leader = crew.communicate(t_us, estimate)

    # Step 1: perception and SLAM integration, M(t) = SLAM(p(t), o(t))
    if obstacles is not None:
        leader.update_map(estimate, obstacles)
        leader.advance(t_us, estimate)

        # Steps 3 and 4: new obstacles and other events e(t)
        event = leader.detect_event(t_us, estimate)
        if event is not None:
            # Step 2: waypoints by A*, path by spline interpolation
            leader.replan(t_us, event)
            leader.deliver(t_us)

    # Step 5: payload NMPC
    cause = leader.solve_event(t_us, estimate)
    if cause is not None:
        leader.solve(estimate, cause)
    leader.deliver(t_us)
    crew.tell_leading_vehicle()

    # Step 6: quadrotor control
    return [agent.act(t_us, estimate) for agent in crew.agents]
