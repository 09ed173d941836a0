"""PX4's commander: arming, modes, offboard and failsafe rules. No bytes, no clock.

Rule numbers (P2, P3, ...) are those of the protocol notes this personality was written from;
every one is a named test in ``tests/unit/test_mock_px4*.py``.
"""

import math
from types import MappingProxyType

from companion.world.frames import GeoPoint
from sim.mock.autopilot import (
    ACTIVE,
    CRITICAL,
    FAILSAFE,
    IN_AIR,
    INFO,
    LANDING,
    ON_GROUND,
    STANDBY,
    TAKING_OFF,
    UNINIT,
    WARNING,
    Autopilot,
    PowerUp,
)
from sim.mock.dynamics import Vector
from sim.mock.geodesy import SphericalProjection
from sim.mock.px4.estimator import Px4Estimator
from sim.mock.px4.failsafe import Cause, Failsafe, Situation, fence_breached
from sim.mock.px4.flight import Flight
from sim.mock.px4.ground import Ground
from sim.mock.px4.health import Companion
from sim.mock.px4.modes import Mode
from sim.mock.px4.parameters import Px4Parameters
from sim.mock.setpoints import Setpoint

HALF_FULL = 0.5
"""No battery failsafe acts on more."""
REST_S = 2.3
"""The estimator notices so long after disarming that the vehicle rests (recorded: 2.0 to 2.6)."""
CENTRED, AT_THE_BOTTOM = 0.2, -0.8
"""Throttle sticks with which a pilot's mode may be armed in."""
UNHEALTHY = "Arming denied: Resolve system health failures first"


class Px4(Autopilot):
    """A PX4 1.18 multicopter."""

    estimator: Px4Estimator
    modes = MappingProxyType({mode.name.lower(): mode for mode in Mode})
    takeover_mode = "posctl"
    hold_mode = "loiter"
    external_mode_number = Mode.OFFBOARD.main

    def __init__(self, start: PowerUp) -> None:
        projection = SphericalProjection(start.place)
        super().__init__(start, Px4Parameters(), Px4Estimator(projection, start.boot_s))
        self.parameters.override("MAV_SYS_ID", start.system_id)
        self.companion = Companion()
        self.failsafe = Failsafe()
        self.flight = Flight(self.body, self.estimator, self.parameters)
        self.ground = Ground()
        self.intention = Mode.LOITER
        self._mode = Mode.LOITER
        self.setpoint: Setpoint | None = None
        self.setpoint_time_s = -math.inf
        self.offboard_seen = False
        self._after_disarm = Mode.LOITER
        self._disarmed_s = -math.inf

    # -- what it shows ---------------------------------------------------------------------

    @property
    def mode(self) -> Mode:
        """The mode that flies: the intention, or a failsafe's."""
        return self._mode

    @property
    def steered(self) -> bool:
        """Whether it flies in OFFBOARD."""
        return self.armed and self.mode is Mode.OFFBOARD

    @property
    def failsafe_words(self) -> str | None:
        """The cause of the failsafe in force."""
        return self.failsafe.cause.value if self.failsafe.cause else None

    @property
    def landed(self) -> bool:
        """Whether the land detector says so."""
        return self.ground.landed

    @property
    def system_status(self) -> int:
        """HEARTBEAT.system_status: UNINIT means "cannot arm now" (P16)."""
        if self.armed:
            return FAILSAFE if self.failsafe.mode is not None else ACTIVE
        return STANDBY if self.can_arm() else UNINIT

    @property
    def landed_state(self) -> int:
        """EXTENDED_SYS_STATE.landed_state."""
        if self.landed:
            return ON_GROUND
        if self.mode is Mode.TAKEOFF:
            return TAKING_OFF
        return LANDING if self.flight.landing else IN_AIR

    @property
    def at_rest(self) -> bool:
        """Whether the estimator has noticed that nothing moves or shakes."""
        return not self.armed and self.now_s - self._disarmed_s >= REST_S

    @property
    def controls(self) -> bool:
        """Whether its controllers have a target: not in OFFBOARD before the first setpoint."""
        return self.mode is not Mode.OFFBOARD or self.offboard_seen

    def can_arm(self) -> bool:
        """Whether the pre-arm checks pass: SYS_STATUS PREARM_CHECK."""
        return (
            self.estimator.ready(self.now_s)
            and not self.intention.prevents_arming
            and self._can_run(self.intention)
        )

    def setpoints_fresh(self) -> bool:
        """Whether the newest setpoint is younger than COM_OF_LOSS_T (P2)."""
        return self.now_s - self.setpoint_time_s <= self.parameters.number("COM_OF_LOSS_T")

    def pilot_present(self) -> bool:
        """Whether manual control is there."""
        return self.pilot.present(self.now_s, self.parameters.number("COM_RC_LOSS_T"))

    # -- what others ask -------------------------------------------------------------------

    def request_mode(self, mode: Mode, *, explain: bool = False) -> bool:
        """Change the operator's intention, or refuse.

        Disarmed, every mode is accepted, even one that cannot run (P3). Armed, a mode that cannot
        run is refused. LAND is always allowed.

        Args:
            mode: What is asked for.
            explain: Whether to say why not: always but for DO_SET_MODE, where PX4 tells
                ground stations (component 190) only.
        """
        if self.armed and mode is not Mode.LAND and not self._can_run(mode):
            if explain:
                self.say(CRITICAL, f"Switching to {mode.title} is currently not available")
            return False
        if mode is not self.intention or self.failsafe.mode is not None:
            self.failsafe.overrule()
        self.intention = mode
        if not mode.prevents_arming:
            self._after_disarm = mode
        self._apply_mode()
        return True

    def arm(self, by: str = "external command") -> bool:
        """Arm, or refuse with a text (P3, P18)."""
        if self.armed:
            return True
        if self.mode.needs_pilot and self.pilot_present() and not self._throttle_is_safe():
            self.say(CRITICAL, "Arming denied: throttle not in safe position")
            return False
        if not self.can_arm():
            self.say(CRITICAL, UNHEALTHY)
            return False
        self.armed = True
        self.ground.arm(self.now_s, self.parameters.number("COM_SPOOLUP_TIME"))
        self.failsafe.arm(pilot_present=self.pilot_present())
        self._set_home()
        self.flight.enter(self.mode, self.home_true_m)
        self.say(INFO, f"Armed by {by}")
        return True

    def disarm(self, by: str = "external command", *, forced: bool = False) -> bool:
        """Disarm; in the air only by force."""
        if not self.armed:
            return True
        if not self.landed and not forced:
            self.say(CRITICAL, "Disarming denied: not landed")
            return False
        self.armed = False
        self._disarmed_s = self.now_s
        self.failsafe.clear()
        self.intention = self._after_disarm
        self._apply_mode()
        self.say(INFO, f"Disarmed by {by}")
        return True

    def take_off(self, altitude_m: float) -> bool:
        """Go to AUTO.TAKEOFF; ``altitude_m`` is AMSL, NaN means MIS_TAKEOFF_ALT above home."""
        self.flight.takeoff_altitude_m = altitude_m
        return self.request_mode(Mode.TAKEOFF, explain=True)

    def reposition(self, point: GeoPoint) -> bool:
        """Hold at ``point`` (P17: this leaves OFFBOARD)."""
        accepted = self.request_mode(Mode.LOITER, explain=True)
        if accepted:
            self.flight.go_to(self.estimator.from_geodetic(point))
        return accepted

    def set_home(self, point: GeoPoint | None) -> bool:
        """Put home to ``point``, or to where the vehicle is; refused before there is a position."""
        if not self.estimator.global_known(self.now_s):
            return False
        self._set_home()
        if point is not None:
            self.home_true_m = self.estimator.from_geodetic(point)
        if self.home_true_m is not None:
            self.flight.home_true_m = self.home_true_m
        return True

    def refuse_setpoint(self, reason: str) -> None:
        """Drop an invalid setpoint: it feeds nothing, and the text says why (P7, P8)."""
        self.setpoints_refused += 1
        self.say(CRITICAL, reason)

    def receive_setpoint(self, setpoint: Setpoint) -> None:
        """Take in a valid setpoint: it feeds the watchdog in any mode (P11)."""
        self.setpoints_received += 1
        if self.mode is not Mode.OFFBOARD:
            self.setpoints_outside_offboard += 1
        if self.deaf:
            return
        self.setpoint_time_s = self.now_s
        self.offboard_seen = True
        self.setpoint = setpoint

    def choose_mode(self, name: str, *, by_pilot: bool) -> None:
        """Let the pilot's switch or a ground station choose a mode by its name."""
        self.pilot.radio |= by_pilot
        self.request_mode(Mode[name.upper()], explain=not by_pilot)

    def lose_radio(self, *, lost: bool) -> None:
        """Let the transmitter fall silent, or return."""
        self.pilot.radio = not lost

    def fence_in(self, radius_m: float) -> None:
        """Set GF_MAX_HOR_DIST."""
        self.parameters.override("GF_MAX_HOR_DIST", radius_m)

    def _shift_held_points(self, step_m: Vector) -> None:
        self.flight.shift(step_m)

    def _keep_home(self, step_m: Vector) -> None:
        super()._keep_home(step_m)
        if self.home_true_m is not None:
            self.flight.home_true_m = self.home_true_m

    # -- how it goes on --------------------------------------------------------------------

    def step(self, now_s: float) -> None:
        """Advance to ``now_s``; steps of 10 ms are meant, longer ones lose accuracy."""
        dt_s = now_s - self.now_s
        self.now_s = now_s
        ready = self.estimator.ready(now_s)
        self.flight.blind = not ready
        if self.estimator.gps_lost_at_s is not None:
            self.mislead(self.estimator.drift_m(now_s, dt_s))
        if self.home_true_m is None and self.estimator.global_known(now_s):
            self._set_home()
        if self.pilot.moves and self.pilot.grabs_sticks(self.parameters.number("MAN_OVERRIDE_SPD")):
            self._sticks_take_over()
        self._notice(dt_s)
        if self.armed and not (ready and self._all_is_well()):
            self._check_failsafe()
        if not self.armed:
            if self.body.on_ground:
                self.body.rest()
            else:
                self.body.fall(dt_s)
            self.ground.landed = self.body.on_ground
            return
        wants_up, wants_down = self.flight.step(
            dt_s,
            flying=self.ground.airborne(self.now_s),
            setpoint=self.setpoint if self.mode is Mode.OFFBOARD else None,
            sticks=self.pilot.sticks,
            drift_mps=self.wind.drift_ned_mps(dt_s),
        )
        self._watch_ground(wants_up=wants_up, wants_down=wants_down)
        if self.armed and self.flight.takeoff_done:
            point = self.flight.hold_true_m
            self.request_mode(Mode.LOITER)
            self.flight.go_to(point)
        for text in self.flight.take_texts():
            self.say(INFO, text)

    def _can_run(self, mode: Mode) -> bool:
        if mode.needs_pilot and not self.pilot_present():
            return False
        if mode is Mode.MISSION:
            return False  # none is ever loaded
        if mode in (Mode.MANUAL, Mode.ACRO, Mode.STABILIZED, Mode.ALTCTL, Mode.LAND):
            return True
        if not self.estimator.ready(self.now_s):
            return False
        return mode is not Mode.OFFBOARD or self.setpoints_fresh()

    def _throttle_is_safe(self) -> bool:
        """Whether the stick is low enough to arm: centred where it climbs, else at the bottom."""
        climbs = self.mode in (Mode.ALTCTL, Mode.POSCTL)
        up = self.pilot.sticks.up
        return up <= CENTRED if climbs else up < AT_THE_BOTTOM

    def _apply_mode(self) -> None:
        mode = self.failsafe.mode or self.intention
        if mode is not self.mode:
            self._mode = mode
            self.setpoint = None
            self.flight.enter(mode, self.home_true_m)

    def _check_failsafe(self) -> None:
        before = self.failsafe.mode
        self.failsafe.update(
            Situation(
                now_s=self.now_s,
                intention=self.intention,
                position_valid=self.estimator.ready(self.now_s),
                setpoints_fresh=self.setpoints_fresh(),
                pilot_present=self.pilot_present(),
                battery_fraction=self.battery.fraction,
                fence_breached=fence_breached(
                    self.parameters, self.body.position_m, self.home_true_m
                ),
            ),
            self.parameters,
        )
        if before is None and self.failsafe.mode is not None:
            delayed = self.failsafe.cause is Cause.PILOT_LOST
            hold = f": entering Hold for {self.parameters.number('COM_FAIL_ACT_T'):.0f} seconds"
            self.say(CRITICAL, "Failsafe activated" + (hold if delayed else ""))
        self._apply_mode()

    def _all_is_well(self) -> bool:
        """Whether with a position no failsafe can act, seen at a glance: so it is in most steps."""
        return (
            self.failsafe.rests
            and self.battery.fraction > HALF_FULL
            and (self.intention is not Mode.OFFBOARD or self.setpoints_fresh())
            and self.failsafe.expects(pilot_present=self.pilot_present())
            and not self.parameters.number("GF_MAX_HOR_DIST")
            and not self.parameters.number("GF_MAX_VER_DIST")
        )

    def _sticks_take_over(self) -> None:
        if self.armed and not self.landed and not self.mode.needs_pilot and self.pilot_present():
            self.request_mode(Mode.POSCTL)
            self.say(INFO, "Pilot took over using sticks")

    def _notice(self, dt_s: float) -> None:
        """Say what changed about the battery and the companion."""
        if self.battery.use(dt_s if self.armed else 0.0, self.parameters.number("BAT_LOW_THR")):
            self.say(WARNING, "Low battery level")
        if self.companion.lost(self.now_s):
            self.say(CRITICAL, "Connection to mission computer lost")

    def _watch_ground(self, *, wants_up: bool, wants_down: bool) -> None:
        """Notice take-off and landing, and disarm by itself (P18)."""
        event = self.ground.update(
            self.now_s, touching=self.body.on_ground, wants_up=wants_up, wants_down=wants_down
        )
        if event is not None:
            self.say(INFO, event)
        if not self.landed:
            return
        key = "COM_DISARM_LAND" if self.ground.flown else "COM_DISARM_PRFLT"
        if 0.0 < self.parameters.number(key) <= self.ground.standing_s(self.now_s):
            self.disarm("landing" if self.ground.flown else "auto preflight disarming")
