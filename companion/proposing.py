"""What the policy proposes, asked once for each position, target and way."""

from dataclasses import dataclass

from companion.arrays import FloatArray
from companion.guidance.guidance import Proposal, propose
from companion.guidance.guide import Guide
from companion.guidance.target import TargetEstimate
from companion.policy.actor import Actor
from companion.positions import Pose
from companion.world.maps import Map
from companion.world.neighbourhood import Neighbourhood


@dataclass(frozen=True, slots=True)
class _Proposed:
    """A proposal and what it was made from; the same again is not asked twice."""

    proposal: Proposal
    pose: Pose
    target_enu_m: FloatArray
    ways_found: int

    def answers(self, pose: Pose, target_enu_m: FloatArray, guide: Guide) -> bool:
        """Return whether everything is as it was: no new position, target or way."""
        same = pose is self.pose and guide.found == self.ways_found
        return same and bool((target_enu_m == self.target_enu_m).all())


class Proposer:
    """Asks one actor on one map.

    Args:
        city: The map.
        actor: What flies.
        v_max_mps: Speed of the longest step the actor can ask for.
    """

    def __init__(self, city: Map, actor: Actor, v_max_mps: float) -> None:
        self._actor, self._v_max_mps = actor, v_max_mps
        self._surroundings = Neighbourhood(city)
        self._guide = Guide(city, actor.contract.layout)
        self._proposed: _Proposed | None = None

    def propose(self, pose: Pose | None, target: TargetEstimate) -> Proposal | None:
        """Return what the policy wants; ``None`` while vehicle or target are not on the map."""
        target_enu_m = target.position_enu_m
        if pose is None or target_enu_m is None:
            return None
        if self._proposed is None or not self._proposed.answers(pose, target_enu_m, self._guide):
            proposal = propose(
                self._actor,
                self._surroundings.around(pose.position_enu_m),
                position_enu_m=pose.position_enu_m,
                velocity_enu_mps=pose.velocity_enu_mps,
                target_enu_m=target_enu_m,
                v_max_mps=self._v_max_mps,
                ahead=self._guide.ahead(pose.position_enu_m, target_enu_m),
            )
            self._proposed = _Proposed(proposal, pose, target_enu_m, self._guide.found)
        return self._proposed.proposal

    def look_ahead(self, pose: Pose | None, target: TargetEstimate) -> None:
        """Do a small part of finding the way, after the setpoint of a tick has left."""
        if pose is not None and target.position_enu_m is not None:
            self._guide.work(pose.position_enu_m, target.position_enu_m)
