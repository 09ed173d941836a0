"""What flight shows of the vehicle: its drift, its lag, and whether it tells the truth."""

import copy
import math

from companion.arrays import FloatArray
from companion.guidance.drift import CALM, Drift, DriftObserver
from companion.guidance.envelope import Envelope
from companion.guidance.freeze import FreezeDetector
from companion.guidance.guidance import Proposal
from companion.guidance.shield import Shield
from companion.policy.contract import Contract
from companion.positions import Pose
from companion.vehicle import FlightMode, Severity, VehicleState

PROVEN_LAG_S = 1.0
"""Up to here a longer lag is no warning: the shield, told of it, is proven on such vehicles."""


class Watch:
    """Compares what one vehicle does with what was sent to it.

    Args:
        shield: Told of a lag that is longer than it believes.
        contract: Of the actor: what training has shown it.
        v_max_mps: The speed cap of the flight.
        start_s: Now.
    """

    def __init__(
        self, shield: Shield, contract: Contract, v_max_mps: float, *, start_s: float
    ) -> None:
        self._shield = shield
        self.envelope = Envelope(contract, v_max_mps)
        self.drift = CALM
        self._observer, self._freeze = DriftObserver(), FreezeDetector()
        self._seen_s = start_s
        self._sent_enu_mps: FloatArray | None = None

    def is_frozen(self, state: VehicleState | None) -> bool:
        """Return whether the position stands still while the vehicle cannot."""
        if state is None:
            return False
        sent = self._sent_enu_mps
        return self._freeze.look(
            state.position_ned_m,
            state.velocity_ned_mps,
            time_s=state.time_s,
            commanded_mps=0.0 if sent is None else math.sqrt(float(sent @ sent)),
        )

    def before_sending(self, state: VehicleState | None, pose: Pose | None) -> None:
        """Compare a new velocity with what was sent before it: what is left is drift."""
        self.drift = self._drift_by(self._observer, state, pose)
        if state is not None and pose is not None:
            self._seen_s = max(self._seen_s, state.time_s)

    def expected_drift(self, state: VehicleState | None, pose: Pose | None) -> Drift:
        """Return what ``drift`` will be after ``before_sending``, if nothing newer comes."""
        return self._drift_by(copy.copy(self._observer), state, pose)

    def _drift_by(
        self, observer: DriftObserver, state: VehicleState | None, pose: Pose | None
    ) -> Drift:
        if state is None or pose is None or state.time_s <= self._seen_s:
            return self.drift
        follows = state.mode is FlightMode.EXTERNAL
        return observer.update(
            pose.velocity_enu_mps,
            self._sent_enu_mps if follows else None,
            self._shield.braking,
            dt_s=state.time_s - self._seen_s,
        )

    def sent(self, velocity_enu_mps: FloatArray | None) -> None:
        """Take down what has left, ``(3,)``; ``None`` if nothing has."""
        self._sent_enu_mps = velocity_enu_mps

    def after_sending(
        self,
        now_s: float,
        state: VehicleState | None,
        pose: Pose | None,
        flown: Proposal | None,
    ) -> list[tuple[str, Severity]]:
        """Compare with training; the speed cap and the shield know in the next tick.

        Args:
            now_s: When the setpoint has left.
            state: Of the vehicle.
            pose: The same on the map.
            flown: What the policy proposed, where it is what flies.

        Returns:
            What is to be said: of the lag the shield reckons with, and of what training has not
            shown.
        """
        if pose is None:
            return []
        said: list[tuple[str, Severity]] = []
        news = self.envelope.watch(
            now_s,
            pose.velocity_enu_mps,
            None if flown is None else self._sent_enu_mps,
            None if flown is None else flown.observation,
            measured_s=None if state is None else state.measured_s,
        )
        believed_s = self._shield.limits.lag_s
        lag_s = self.envelope.longer_lag_s(believed_s)
        if lag_s is not None:
            self._shield.reckon_with_lag(lag_s)
            said.append(_slower(lag_s, believed_s))
        if news:
            said.append((news, Severity.WARNING))
        return said


def _slower(lag_s: float, believed_s: float) -> tuple[str, Severity]:
    """Return what a pilot should know of a vehicle that lags more than was believed."""
    words = (
        f"the vehicle follows more slowly than assumed (velocity lag {lag_s:g} s, not "
        f"{believed_s:g} s): the shield brakes earlier from now on"
    )
    if lag_s <= PROVEN_LAG_S:
        return words, Severity.INFO
    advice = "fly slower (--v-max) and look at payload, tuning, link and the load of this computer"
    return f"{words}; {advice}", Severity.WARNING
