"""What every autopilot of the mock has, whoever made it: a body, beliefs, a pilot, texts."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from companion.world.frames import GeoPoint
from sim.mock.dynamics import ZERO, PointMass, Vector, Wind
from sim.mock.estimator import Estimator, add, subtract
from sim.mock.health import Battery
from sim.mock.parameters import Parameters
from sim.mock.pilot import Pilot

EMERGENCY, CRITICAL, ERROR, WARNING, INFO = 0, 2, 3, 4, 6
"""MAV_SEVERITY of the texts."""

UNINIT, BOOTING, STANDBY, ACTIVE, FAILSAFE = 0, 1, 3, 4, 5
"""MAV_STATE of HEARTBEAT."""

ON_GROUND, IN_AIR, TAKING_OFF, LANDING = 1, 2, 3, 4
"""MAV_LANDED_STATE of EXTENDED_SYS_STATE."""

COMPONENT_ID = 1
"""MAV_COMP_ID_AUTOPILOT1."""


class FlightMode(Protocol):
    """A mode of any autopilot: one member of an enumeration."""

    @property
    def name(self) -> str:
        """The name in reports and specifications."""
        ...

    @property
    def is_external(self) -> bool:
        """Whether the vehicle obeys setpoints in it."""
        ...


@dataclass(frozen=True, slots=True)
class PowerUp:
    """What an autopilot finds when it is switched on."""

    place: GeoPoint
    boot_s: float
    radio: bool
    body: PointMass
    wind: Wind
    noise_m: float
    rng: np.random.Generator
    system_id: int = 1


class Autopilot(ABC):
    """The vehicle behind the messages; ``step`` it with the time since power-up."""

    modes: ClassVar[Mapping[str, FlightMode]]
    """The modes by their names in lower case, as faults name them."""
    takeover_mode: ClassVar[str]
    """What a pilot's mode switch chooses."""
    external_mode_number: ClassVar[int]
    """DO_SET_MODE param2 for the mode in which it obeys setpoints."""
    hold_mode: ClassVar[str]
    """What a ground station chooses to stop the vehicle."""

    def __init__(self, start: PowerUp, parameters: Parameters, estimator: Estimator) -> None:
        self.now_s = 0.0
        self.system_id = start.system_id
        self._noise_m = start.noise_m
        self._rng = start.rng
        self.body = start.body
        self.wind = start.wind
        self.parameters = parameters
        self.estimator = estimator
        self.pilot = Pilot(radio=start.radio)
        self.battery = Battery()
        self.armed = False
        self.home_true_m: Vector | None = None
        self.home_count = 0
        """Rises whenever HOME_POSITION changes."""
        self.setpoints_received = 0
        self.setpoints_outside_offboard = 0
        self.setpoints_refused = 0
        self.wants_reboot = False
        """Whether somebody has asked it to restart, and it obeys."""
        self.deaf = False
        """A fault: setpoints no longer reach the autopilot."""
        self._texts: list[tuple[int, str]] = []

    @property
    @abstractmethod
    def mode(self) -> FlightMode:
        """The mode that flies."""

    @property
    @abstractmethod
    def landed(self) -> bool:
        """Whether the land detector says so."""

    @property
    @abstractmethod
    def system_status(self) -> int:
        """HEARTBEAT.system_status."""

    @property
    @abstractmethod
    def landed_state(self) -> int:
        """EXTENDED_SYS_STATE.landed_state."""

    @property
    @abstractmethod
    def failsafe_words(self) -> str | None:
        """The cause of the failsafe in force, for the referee's timeline."""

    @property
    @abstractmethod
    def steered(self) -> bool:
        """Whether somebody's setpoints fly the vehicle now: what faults call ``offboard``."""

    @abstractmethod
    def can_arm(self) -> bool:
        """Whether the pre-arm checks pass: SYS_STATUS PREARM_CHECK."""

    @abstractmethod
    def step(self, now_s: float) -> None:
        """Advance to ``now_s``; steps of 10 ms are meant, longer ones lose accuracy."""

    @abstractmethod
    def choose_mode(self, name: str, *, by_pilot: bool) -> None:
        """Let the pilot's switch or a ground station choose a mode by its name."""

    @abstractmethod
    def lose_radio(self, *, lost: bool) -> None:
        """Let the transmitter fall silent, or return."""

    @abstractmethod
    def fence_in(self, radius_m: float) -> None:
        """Set a geofence of ``radius_m`` around home; 0 takes it away."""

    def noisy_true_m(self) -> Vector:
        """Return the true position plus white noise, as sensors see it."""
        if self._noise_m <= 0.0:
            return self.body.position_m
        n, e, d = (self._noise_m * float(value) for value in self._rng.standard_normal(3))
        return add(self.body.position_m, (n, e, d))

    def local_position_m(self) -> Vector:
        """Return what LOCAL_POSITION_NED says."""
        return self.estimator.to_local(self.noisy_true_m())

    def say(self, severity: int, text: str) -> None:
        """Queue a text for the ground stations."""
        self._texts.append((severity, text))

    def take_texts(self) -> list[tuple[int, str]]:
        """Return the texts since the last call, oldest first."""
        texts, self._texts = self._texts, []
        return texts

    def mislead(self, step_m: Vector) -> None:
        """Shift the estimate without a reset: the vehicle follows its belief the other way."""
        if step_m != ZERO:
            self.estimator.error_m = add(self.estimator.error_m, step_m)
            self._shift_held_points(step_m)
            self._keep_home(step_m)

    def lose_gps(self, *, lost: bool) -> None:
        """Let the receiver lose its fix, or find it again: then the estimate is right again."""
        if lost is (self.estimator.gps_lost_at_s is not None):
            return
        self.estimator.gps_lost_at_s = self.now_s if lost else None
        if not lost:
            self.reset_estimate(subtract(ZERO, self.estimator.error_m))

    def reset_estimate(self, step_m: Vector) -> None:
        """Shift the estimate with a reset (P20): what the vehicle holds on to moves along."""
        self.estimator.reset(step_m)
        self._keep_home(step_m)

    @abstractmethod
    def _shift_held_points(self, step_m: Vector) -> None:
        """Keep the points it flies to at their believed place: they now mean other true ones."""

    def _keep_home(self, step_m: Vector) -> None:
        """Leave home at its latitude and longitude: it now means another true place."""
        if self.home_true_m is not None:
            self.home_true_m = subtract(self.home_true_m, step_m)

    def _set_home(self) -> None:
        self.home_true_m = self.body.position_m
        self.home_count += 1
