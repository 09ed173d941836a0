"""The vehicle's health: GPS, estimator, battery, sensors, reboots, take-off and landing."""

import math
from collections.abc import Callable, Mapping

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.link.autopilots import ArduPilot, Autopilot, Px4
from companion.review.story import Message, Story
from companion.vehicle import LandedState, Severity

_FIX_3D = dialect.GPS_FIX_TYPE_3D_FIX
_REBOOT_MS, _CLOCK_WRAPS_MS = 1000, 1 << 31
_GLITCH = {"px4": dialect.ESTIMATOR_GPS_GLITCH, "ardupilot": dialect.EKF_GPS_GLITCHING}
_LOW, _EMPTY = 25, 10  # percent
_ORIGIN_SAME_M = 0.5
_SENSORS = {
    dialect.MAV_SYS_STATUS_SENSOR_RC_RECEIVER: "radio control",
    dialect.MAV_SYS_STATUS_SENSOR_3D_MAG: "compass",
    dialect.MAV_SYS_STATUS_SENSOR_3D_GYRO: "gyroscope",
    dialect.MAV_SYS_STATUS_SENSOR_3D_ACCEL: "accelerometer",
    dialect.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE: "barometer",
    dialect.MAV_SYS_STATUS_GEOFENCE: "geofence",
    dialect.MAV_SYS_STATUS_SENSOR_PROPULSION: "propulsion",
}
_LANDED = {
    LandedState.ON_GROUND: "on ground",
    LandedState.IN_AIR: "in the air",
    LandedState.TAKING_OFF: "taking off",
    LandedState.LANDING: "landing",
}


class Health:
    """Follows what the vehicle says of itself."""

    def __init__(self, story: Story, firmware: str) -> None:
        self._story = story
        self._firmware = firmware
        self._judge: Autopilot = ArduPilot() if firmware == "ardupilot" else Px4()
        self._had_fix = False
        self._was_valid: bool | None = None
        self._resets: int | None = None
        self._boot_ms: int | None = None
        self._origin: tuple[float, float, float] | None = None
        self._healthy: dict[int, bool] = {}
        self._battery_told = 101
        self._battery_first: int | None = None
        self._battery_last: int | None = None
        self._volts: list[float] = []
        self.landed = LandedState.UNKNOWN
        self.took_off_s: float | None = None
        self.air_s = 0.0
        self.handlers: Mapping[int, Callable[[Message], None]] = {
            number: self._of_the_vehicle(handle)
            for number, handle in {
                dialect.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps,
                dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS: self._estimator,
                dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT: self._estimator,
                dialect.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
                dialect.MAVLINK_MSG_ID_ODOMETRY: self._odometry,
                dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self._global_origin,
                dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._extended,
                dialect.MAVLINK_MSG_ID_SYSTEM_TIME: self._system_time,
                dialect.MAVLINK_MSG_ID_FENCE_STATUS: self._fence,
                dialect.MAVLINK_MSG_ID_NAMED_VALUE_INT: self._named,
            }.items()
        }

    def finish(self, end_s: float) -> None:
        """Add the facts."""
        if self.took_off_s is not None:
            self.air_s += end_s - self.took_off_s
        facts = self._story.facts
        if self.air_s:
            facts.append(("In the air", f"{self.air_s:.1f} s"))
        battery = []
        if self._battery_first is not None:
            battery.append(f"{self._battery_first} -> {self._battery_last} %")
        if self._volts:
            battery.append(f"{self._volts[0]:.1f} -> {self._volts[-1]:.1f} V")
        if battery:
            facts.append(("Battery", ", ".join(battery)))

    def height(self, now_s: float, height_m: float) -> None:
        """Tell take-off and landing where no EXTENDED_SYS_STATE does."""
        if self.landed is not LandedState.UNKNOWN or not math.isfinite(height_m):
            return
        if not self._story.in_air and self._story.armed and height_m > 1.0:
            self._leave_ground(now_s)
        elif self._story.in_air and (height_m < 0.3 or not self._story.armed):
            self._touch_ground(now_s)

    def _of_the_vehicle(self, handle: Callable[[Message], None]) -> Callable[[Message], None]:
        def checked(message: Message) -> None:
            if message.system_id == self._story.vehicle:
                handle(message)

        return checked

    def _gps(self, message: Message) -> None:
        fix, story = message.fields.fix_type, self._story
        has = fix >= _FIX_3D
        if has == self._had_fix and story.now("gps"):
            return
        satellites = message.fields.satellites_visible
        seen = "" if satellites == 255 else f", {satellites} satellites"
        story.band("gps", message.time_s, "fix" if has else "no fix")
        if has:
            story.tell(message.time_s, f"GPS has a fix{seen}", Severity.NOTICE)
        elif self._had_fix:
            story.warn(message.time_s, f"GPS LOST its fix{seen}")
        self._had_fix = has

    def _estimator(self, message: Message) -> None:
        flags, story, now_s = message.fields.flags, self._story, message.time_s
        glitch = bool(flags & _GLITCH.get(self._firmware, 0))
        valid = self._judge.position_valid(flags, self.landed)
        state = "glitch" if glitch else "ok" if valid else "no position"
        if not story.band("estimator", now_s, state):
            return
        if valid:
            story.tell(now_s, "the estimator vouches for the position", Severity.NOTICE)
        elif self._was_valid or glitch:
            what = "a GPS GLITCH" if glitch else "NO LONGER vouches for the position"
            story.warn(now_s, f"the estimator: {what} (flags {flags:#x})")
        self._was_valid = valid

    def _sys_status(self, message: Message) -> None:
        fields, story, now_s = message.fields, self._story, message.time_s
        percent = fields.battery_remaining
        if 0 <= percent <= 100:
            if self._battery_first is None:
                self._battery_first = percent
            self._battery_last = percent
            passed = [limit for limit in (_LOW, _EMPTY) if percent <= limit < self._battery_told]
            if passed:
                story.warn(now_s, f"BATTERY at {percent} %")
                self._battery_told = min(passed)
        if 0 < fields.voltage_battery < 65535:
            self._volts.append(fields.voltage_battery * 1e-3)
        enabled = fields.onboard_control_sensors_enabled
        for bit, name in _SENSORS.items():
            if not enabled & bit:
                continue
            healthy = bool(fields.onboard_control_sensors_health & bit)
            if self._healthy.get(bit, healthy) != healthy:
                if healthy:
                    story.tell(now_s, f"{name} is healthy again", Severity.NOTICE)
                else:
                    story.warn(now_s, f"{name} is UNHEALTHY")
            self._healthy[bit] = healthy

    def _odometry(self, message: Message) -> None:
        counter = message.fields.reset_counter
        if self._resets not in (None, counter):
            text = f"the estimator RESET itself (counter {self._resets} -> {counter})"
            if self._story.in_air:
                self._story.warn(message.time_s, f"{text}: the position may have jumped")
            elif self._story.armed:
                self._story.tell(message.time_s, text)
        self._resets = counter

    def _global_origin(self, message: Message) -> None:
        fields = message.fields
        origin = (fields.latitude * 1e-7, fields.longitude * 1e-7, fields.altitude * 1e-3)
        before, self._origin = self._origin, origin
        if before is None:
            return
        north_m = (origin[0] - before[0]) * 111_320.0
        east_m = (origin[1] - before[1]) * 111_320.0 * math.cos(math.radians(origin[0]))
        moved_m = math.hypot(north_m, east_m, origin[2] - before[2])
        if moved_m > _ORIGIN_SAME_M:
            self._story.warn(message.time_s, f"the local ORIGIN moved by {moved_m:.1f} m")

    def _system_time(self, message: Message) -> None:
        boot_ms = message.fields.time_boot_ms
        before_ms, self._boot_ms = self._boot_ms, boot_ms
        if before_ms is not None and _REBOOT_MS < before_ms - boot_ms < _CLOCK_WRAPS_MS:
            self._story.warn(
                message.time_s,
                f"the autopilot REBOOTED: its clock went from {before_ms / 1e3:.0f} s to "
                f"{boot_ms / 1e3:.0f} s",
            )

    def _extended(self, message: Message) -> None:
        story, now_s = self._story, message.time_s
        try:
            landed = LandedState(message.fields.landed_state)
        except ValueError:
            return
        self.landed = landed
        if landed in _LANDED:
            story.band("landed", now_s, _LANDED[landed])
        if landed in (LandedState.IN_AIR, LandedState.TAKING_OFF) and not story.in_air:
            self._leave_ground(now_s)
        elif landed is LandedState.ON_GROUND and story.in_air:
            self._touch_ground(now_s)

    def _leave_ground(self, now_s: float) -> None:
        self._story.in_air = True
        self.took_off_s = now_s
        self._story.tell(now_s, "took off", Severity.NOTICE)

    def _touch_ground(self, now_s: float) -> None:
        self._story.in_air = False
        self._story.landed_s = now_s
        flown_s = 0.0 if self.took_off_s is None else now_s - self.took_off_s
        self.air_s += flown_s
        self.took_off_s = None
        self._story.tell(now_s, f"landed, after {flown_s:.1f} s in the air", Severity.NOTICE)

    def _fence(self, message: Message) -> None:
        breached = "outside" if message.fields.breach_status else "inside"
        if self._story.band("geofence", message.time_s, breached) and breached == "outside":
            self._story.warn(message.time_s, "the autopilot's GEOFENCE is breached")

    def _named(self, message: Message) -> None:
        """Contacts with obstacles, as a simulated vehicle counts them."""
        name = message.fields.name
        if name == "contacts" and message.fields.value:
            count = f"{message.fields.value}"
            if self._story.band("contacts", message.time_s, count):
                self._story.warn(message.time_s, f"CONTACT with an obstacle, number {count}")
