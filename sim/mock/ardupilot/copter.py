"""ArduCopter itself: arming, modes, GUIDED and failsafes. No bytes, no clock.

Rule numbers (A1, A2, ...) are those of the protocol notes this personality was written from;
every one is a named test in ``tests/unit/test_mock_ardupilot*.py``.
"""

from types import MappingProxyType

from companion.world.frames import GeoPoint
from sim.mock.ardupilot import boot
from sim.mock.ardupilot.checks import arming_problem, mode_problem, prearm_problem
from sim.mock.ardupilot.estimator import INITIALISED_S, STOPPED_AIDING_S, CopterEstimator
from sim.mock.ardupilot.failsafe import Failsafes, Situation
from sim.mock.ardupilot.flight import Flight, Guided
from sim.mock.ardupilot.ground import DISARM_S, Ground
from sim.mock.ardupilot.modes import NUMBERS, Mode, find_mode
from sim.mock.ardupilot.parameters import CopterParameters
from sim.mock.ardupilot.radio import Radio
from sim.mock.ardupilot.steering import Steering
from sim.mock.autopilot import (
    ACTIVE,
    BOOTING,
    CRITICAL,
    FAILSAFE,
    IN_AIR,
    INFO,
    LANDING,
    ON_GROUND,
    STANDBY,
    TAKING_OFF,
    WARNING,
    Autopilot,
    PowerUp,
)
from sim.mock.dynamics import ZERO, Vector
from sim.mock.estimator import subtract
from sim.mock.geodesy import FlatProjection
from sim.mock.setpoints import Setpoint

NO_WAY_BACK_S = 22.5
"""Without a position for so long, the way that SmartRTL would go back is given up."""
CONTROLLER_MEMORY_S = 0.2
"""HEARTBEAT says "guided" while the position controller has run within this time."""


class ArduCopter(Autopilot):
    """An ArduCopter 4.6.3."""

    estimator: CopterEstimator
    modes = MappingProxyType({mode.name.lower(): mode for mode in Mode})
    takeover_mode = "loiter"
    hold_mode = "brake"
    external_mode_number = Mode.GUIDED.value

    def __init__(self, start: PowerUp) -> None:
        estimator = CopterEstimator(FlatProjection(start.place), start.boot_s)
        super().__init__(start, CopterParameters(), estimator)
        self.parameters.override("SYSID_THISMAV", start.system_id)
        self.failsafes = Failsafes(self.parameters, self.say)
        self.flight = Flight(self.body, self.estimator, self.parameters)
        self.ground = Ground()
        self.steering = Steering(self.flight, self.ground, self.estimator, self.parameters)
        self.radio = Radio(self.parameters)
        self._story = boot.BootStory(estimator)
        self._mode = Mode.STABILIZE
        self._controlled_s = 0.0
        self._compass_aligned = False
        self._glitch_told = self._aiding_told = self._path_told = self._gps_off = False

    # -- what it shows ---------------------------------------------------------------------

    @property
    def mode(self) -> Mode:
        """The mode that flies."""
        return self._mode

    @property
    def initialised(self) -> bool:
        """Whether it has booted so far that it streams and may be asked to arm."""
        return self.now_s >= self.estimator.at(INITIALISED_S)

    @property
    def landed(self) -> bool:
        """Whether the land detector says so."""
        return self.ground.landed

    @property
    def steered(self) -> bool:
        """Whether setpoints fly it: in the air in GUIDED, after the first one."""
        return self.armed and self.mode is Mode.GUIDED and self.steering.setpoint is not None

    @property
    def failsafe_words(self) -> str | None:
        """The failsafes in force."""
        return " and ".join(self.failsafes.tripped) or None

    @property
    def controls_position(self) -> bool:
        """Whether the position controller runs: the "guided" bit of HEARTBEAT.base_mode."""
        return not self.initialised or self.now_s - self._controlled_s < CONTROLLER_MEMORY_S

    @property
    def system_status(self) -> int:
        """HEARTBEAT.system_status (A19)."""
        if not self.initialised:
            return BOOTING
        if self.failsafes.tripped:
            return FAILSAFE
        return STANDBY if self.landed else ACTIVE

    @property
    def landed_state(self) -> int:
        """EXTENDED_SYS_STATE.landed_state."""
        if self.landed:
            return ON_GROUND
        if self.mode is Mode.LAND or (self.mode is Mode.RTL and self.flight.landing):
            return LANDING
        taking_off = self.mode is Mode.GUIDED and self.flight.guided is Guided.TAKEOFF
        return TAKING_OFF if taking_off and not self.flight.taken_off() else IN_AIR

    @property
    def position_good(self) -> bool:
        """Whether modes that need a position may be flown."""
        return self.estimator.ready(self.now_s) and not self.failsafes.ekf

    def can_arm(self) -> bool:
        """Whether the pre-arm checks pass: SYS_STATUS PREARM_CHECK."""
        return self._prearm_problem() is None

    # -- what others ask -------------------------------------------------------------------

    def request_mode(self, number: int, *, by_gcs: bool = True) -> bool:
        """Change the mode, or refuse with a text (A11).

        Disarmed, every mode is accepted, whatever it would need in flight.
        """
        mode = find_mode(number)
        if mode is None and number not in NUMBERS:
            self.say(WARNING, f"No such mode {number}")
            return False
        if mode is self._mode:
            return True
        problem = mode_problem(
            mode,
            blocked=int(self.parameters.number("FLTMODE_GCSBLOCK")) if by_gcs else 0,
            armed=self.armed,
            position_good=self.position_good,
        )
        if mode is None or problem is not None:
            name = f"mode {number}" if mode is None else mode.name
            self.say(WARNING, f"Mode change to {name} failed: {problem}")
            return False
        self._enter(mode)
        return True

    def arm(self, *, forced: bool = False) -> bool:
        """Arm, or refuse with a text (A10, A12)."""
        if self.armed:
            return True
        problem = self._prearm_problem() or arming_problem(self.mode)
        if problem is not None and not (forced and self.initialised):
            self.say(CRITICAL, f"Arm: {problem}")
            return False
        self.armed = True
        self._compass_aligned = False
        self.ground.arm(self.now_s)
        self._set_home()
        self.say(INFO, "Arming motors")
        return True

    def disarm(self, *, forced: bool = False) -> bool:
        """Disarm; in the air only by force."""
        if self.armed and not self.landed and not forced:
            return False
        if self.armed:
            self.armed = False
            self.failsafes.disarm()
            self.say(INFO, "Disarming motors")
        return True

    def take_off(self, altitude_m: float) -> bool:
        """Climb to ``altitude_m`` above home in GUIDED; only armed and from the ground."""
        if not (self.armed and self.landed and self.mode is Mode.GUIDED and altitude_m > 0.0):
            return False
        self.flight.take_off(altitude_m)
        self.steering.setpoint = None
        self.ground.take_off(self.now_s)
        return True

    def reposition(self, point: GeoPoint) -> bool:
        """Fly to ``point`` in GUIDED (A15)."""
        if not self.request_mode(Mode.GUIDED.value):
            return False
        target_m = self.estimator.from_geodetic(point)
        self.steering.follow(self.now_s, Setpoint(self.estimator.to_local(target_m)))
        return True

    def receive_setpoint(self, setpoint: Setpoint | None) -> None:
        """Take in a setpoint; ``None`` is one that made no sense and stops the vehicle (A2-A4)."""
        self.setpoints_received += 1
        if self.mode is not Mode.GUIDED:
            self.setpoints_outside_offboard += 1  # dropped without a word (A1)
            return
        if self.deaf:
            return
        if setpoint is None:
            self.setpoints_refused += 1
        self.steering.follow(self.now_s, setpoint)

    def choose_mode(self, name: str, *, by_pilot: bool) -> None:
        """Let the pilot's switch or a ground station choose a mode by its name."""
        self.pilot.radio |= by_pilot
        self.request_mode(Mode[name.upper()].value, by_gcs=not by_pilot)

    def lose_radio(self, *, lost: bool) -> None:
        """Let the transmitter fall silent, or return."""
        self.pilot.radio = not lost
        self._fail_over(self.failsafes.lose_radio(lost=lost, mode=self.mode))

    def override_radio(self, pulses: dict[int, int]) -> None:
        """Take in pulses of a transmitter by channel: sticks, mode switch, a lost throttle."""
        self.radio.override(self.now_s, pulses)
        self.pilot.move(self.now_s, self.radio.sticks)
        number = self.radio.moved_switch()
        if number is not None:
            self.request_mode(number, by_gcs=False)
        if self.radio.throttle_lost is not self.failsafes.radio:
            self.lose_radio(lost=self.radio.throttle_lost)

    def fence_in(self, radius_m: float) -> None:
        """Set a circle fence."""
        self.parameters.override("FENCE_ENABLE", radius_m > 0.0)
        self.parameters.override("FENCE_RADIUS", radius_m)

    def _shift_held_points(self, step_m: Vector) -> None:
        if self.flight.hold_true_m is not None:
            self.flight.hold_true_m = subtract(self.flight.hold_true_m, step_m)
        self.flight.target_true_m = subtract(self.flight.target_true_m, step_m)

    # -- how it goes on --------------------------------------------------------------------

    def step(self, now_s: float) -> None:
        """Advance to ``now_s``; steps of 10 ms are meant, longer ones lose accuracy."""
        dt_s = now_s - self.now_s
        self.now_s = now_s
        self._texts += self._story.take_due(now_s)
        self._watch_gps()
        if self.radio.expire(now_s):
            self.pilot.move(now_s, self.radio.sticks)
        self.mislead(self.estimator.drift_m(now_s, dt_s))
        if self.home_true_m is None and self.estimator.origin_known(now_s):
            self._set_home()
        self._watch_position_controller()
        if not self.armed:
            if self.body.on_ground:
                self.body.rest()
            else:
                self.body.fall(dt_s)
            self.ground.landed = self.body.on_ground
            return
        self.battery.use(dt_s, 0.0)
        self._watch()
        self._fly(dt_s)

    def _fly(self, dt_s: float) -> None:
        self.flight.home_true_m = self.home_true_m or ZERO
        flying = self.ground.airborne(self.now_s)
        if self.mode is Mode.GUIDED:
            self.steering.steer(self.now_s)
        setpoint = self.steering.setpoint
        demand = self.flight.demand(self.mode, self.now_s, setpoint, self.pilot.sticks)
        drift = self.wind.drift_ned_mps(dt_s)
        if flying:
            self.body.fly(demand.velocity_mps, dt_s, drift_mps=drift)
            self.body.turn(demand.yaw_rate_radps, dt_s)
        else:
            self.body.rest()
        self.ground.update(
            self.now_s, touching=self.body.on_ground, wants_down=demand.velocity_mps[2] > 0.1
        )
        lands = self.mode is Mode.LAND or (self.mode is Mode.RTL and self.flight.landing)
        delay_s = self.parameters.number("DISARM_DELAY")
        if (lands and self.ground.touched_s(self.now_s) >= DISARM_S) or (
            0.0 < delay_s <= self.ground.standing_s(self.now_s)
        ):
            self.disarm()

    def _enter(self, mode: Mode) -> None:
        self._mode = mode
        self.steering.setpoint = None
        self.ground.cancel_take_off()
        self.flight.home_true_m = self.home_true_m or ZERO
        self.flight.enter(mode, self.now_s)
        if mode not in (Mode.STABILIZE, Mode.ALT_HOLD):
            self._controlled_s = self.now_s

    def _prearm_problem(self) -> str | None:
        return prearm_problem(self.estimator, self.now_s, self.mode, initialised=self.initialised)

    def _watch_position_controller(self) -> None:
        """Note when it runs; RTL stands still before arming, LAND may go without (recorded)."""
        mode = self.mode
        idle = mode in (Mode.STABILIZE, Mode.ALT_HOLD) or (mode is Mode.RTL and not self.armed)
        blind = mode is Mode.LAND and self.flight.blind and not self.landed
        if not idle and not blind:
            self._controlled_s = self.now_s

    def lose_gps(self, *, lost: bool) -> None:
        """Let the receiver lose its fix, or find it again."""
        if not lost and self.estimator.gps_lost_at_s is not None:
            if not self.estimator.local_known(self.now_s):
                self._texts += [(INFO, text) for text in boot.USING_GPS]
            self._aiding_told = self._path_told = False
        super().lose_gps(lost=lost)

    def _watch_gps(self) -> None:
        """Obey SIM_GPS_DISABLE, and say what a long loss of GPS means."""
        switched_off = self.parameters.number("SIM_GPS_DISABLE") > 0.0
        if switched_off is not self._gps_off:
            self._gps_off = switched_off
            self.lose_gps(lost=switched_off)
        lost_s = self.now_s - (self.estimator.gps_lost_at_s or self.now_s)
        if lost_s >= STOPPED_AIDING_S and not self._aiding_told:
            self._aiding_told = True
            self._texts += [(WARNING, text) for text in boot.STOPPED_AIDING]
        if lost_s >= NO_WAY_BACK_S and self.armed and not self._path_told:
            self._path_told = True
            self.say(WARNING, "SmartRTL deactivated: bad position")

    def _watch(self) -> None:
        """Look after the failsafes, and say what the estimator says in flight."""
        wanted = self.failsafes.update(
            Situation(
                now_s=self.now_s,
                mode=self.mode,
                position_good=self.estimator.ready(self.now_s),
                battery=self.battery,
                position_m=self.body.position_m,
                home_true_m=self.home_true_m,
            )
        )
        self._fail_over(wanted)
        if self.estimator.glitching is not self._glitch_told:
            self._glitch_told = self.estimator.glitching
            words = "GPS Glitch or Compass error" if self._glitch_told else "Glitch cleared"
            self.say(CRITICAL, words)
        if not self._compass_aligned and -self.body.position_m[2] > boot.IN_FLIGHT_M:
            self._compass_aligned = True
            self._texts += [(INFO, text) for text in boot.IN_FLIGHT]

    def _fail_over(self, mode: Mode | None) -> None:
        """Obey a failsafe: without a position it lands, on the ground it disarms."""
        if mode is None or not self.armed:
            return
        if self.landed:
            self.disarm()
            return
        if mode.requires_position and not self.position_good:
            mode = Mode.LAND
        if mode is not self.mode:
            self._enter(mode)
        if mode is Mode.LAND:
            self.flight.land_after_failsafe(self.now_s, blind=self.failsafes.ekf)
