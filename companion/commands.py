"""Commands that others address to us over MAVLink: judged before the acknowledgement leaves.

DO_REPOSITION sets the target where none was given at the start. DO_PAUSE_CONTINUE with 0 gives
the vehicle back and ends the run; nothing sent to us engages anything: that takes an operator who
starts the program.
"""

from companion.positions import Positions
from companion.preflight import target_problem, target_warning
from companion.vehicle import CommandAnswer, CommandKind, OperatorCommand, Verdict
from companion.world.maps import Map


class Commands:
    """Judges commands and keeps what they ask for until the loop takes it."""

    def __init__(
        self, city: Map, positions: Positions, *, target_given: bool, margin_m: float
    ) -> None:
        """Judge for one run.

        Args:
            city: The map that a target must lie on.
            positions: Where a new target is set.
            target_given: Whether the target was given at the start; then nobody may change it.
            margin_m: What the shield keeps.
        """
        self._map, self._positions, self._target_given = city, positions, target_given
        self._margin_m = margin_m
        self._target_changed = False
        self.paused_by = ""
        """Who has paused us; empty when nobody."""

    def judge(self, command: OperatorCommand) -> CommandAnswer:
        """Obey or refuse; ``companion.vehicle.Vehicle.judge_commands``."""
        if command.kind is CommandKind.REPOSITION:
            return self._reposition(command)
        if command.kind is CommandKind.PAUSE:
            self.paused_by = self.paused_by or command.sender
            return CommandAnswer(Verdict.ACCEPTED)
        if self.paused_by:
            return CommandAnswer(Verdict.DENIED, "start the program again to engage again")
        return CommandAnswer(Verdict.ACCEPTED, "nothing was paused")

    def take_target_changed(self) -> bool:
        """Return whether the target was changed since the last call."""
        changed, self._target_changed = self._target_changed, False
        return changed

    def _reposition(self, command: OperatorCommand) -> CommandAnswer:
        if self._target_given or command.position is None:
            return CommandAnswer(Verdict.DENIED, "the target was given at the start")
        place = self._positions.on_map(command.position)
        if place is None:
            return CommandAnswer(Verdict.NOT_NOW, "map and earth are not tied yet")
        problem = target_problem(self._map, place, self._margin_m)
        if problem:
            return CommandAnswer(Verdict.DENIED, problem)
        self._positions.track.set_static(place)
        self._target_changed = True
        return CommandAnswer(Verdict.ACCEPTED, target_warning(self._map, place, self._margin_m))
