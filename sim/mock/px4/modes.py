"""PX4's flight modes: numbers, names and what each asks for."""

from enum import Enum

MODE_MANUAL_INPUT = 0x40
MODE_STABILIZE = 0x10
MODE_GUIDED = 0x08
MODE_AUTO = 0x04
MODE_CUSTOM = 0x01
ARMED = 0x80


class Mode(Enum):
    """A PX4 mode as (main mode, sub mode) of HEARTBEAT.custom_mode."""

    MANUAL = (1, 0)
    ALTCTL = (2, 0)
    POSCTL = (3, 0)
    ACRO = (5, 0)
    TAKEOFF = (4, 2)
    LOITER = (4, 3)
    MISSION = (4, 4)
    RTL = (4, 5)
    LAND = (4, 6)
    OFFBOARD = (6, 0)
    STABILIZED = (7, 0)

    def __init__(self, main: int, sub: int) -> None:
        """Note once what is asked at every step."""
        self.main = main
        """The main mode, as in DO_SET_MODE param2."""
        self.sub = sub
        """The sub mode, as in DO_SET_MODE param3; 0 outside AUTO."""
        self.custom_mode = main << 16 | sub << 24
        """HEARTBEAT.custom_mode: main mode in byte 2, sub mode in byte 3."""
        self.is_external = main == 6
        """Whether the vehicle obeys setpoints in it."""
        self.needs_pilot = main in (1, 2, 3, 5, 7)
        """Whether somebody has to hold the sticks."""
        self.is_auto = main == 4
        """Whether the autopilot flies by itself."""
        self.prevents_arming = main == 4 and sub in (5, 6)
        """Whether arming is denied in this mode."""

    @property
    def title(self) -> str:
        """The word PX4 uses for it in its texts."""
        return _TITLES[self]

    def base_mode(self, *, armed: bool, offboard_seen: bool) -> int:
        """Return HEARTBEAT.base_mode.

        Args:
            armed: Whether the motors are armed.
            offboard_seen: Whether any setpoint came yet. Before the first one OFFBOARD controls
                nothing, and PX4 clears the stabilize bit (0x01 instead of 0x11).
        """
        bits = MODE_CUSTOM | (ARMED if armed else 0)
        if self.is_auto:
            return bits | MODE_STABILIZE | MODE_GUIDED | MODE_AUTO
        if self is Mode.OFFBOARD:
            return bits | (MODE_STABILIZE if offboard_seen else 0)
        return bits | MODE_MANUAL_INPUT | (0 if self is Mode.ACRO else MODE_STABILIZE)


_TITLES = {
    Mode.MANUAL: "Manual",
    Mode.ALTCTL: "Altitude",
    Mode.POSCTL: "Position",
    Mode.ACRO: "Acro",
    Mode.TAKEOFF: "Takeoff",
    Mode.LOITER: "Hold",
    Mode.MISSION: "Mission",
    Mode.RTL: "Return",
    Mode.LAND: "Land",
    Mode.OFFBOARD: "Offboard",
    Mode.STABILIZED: "Stabilized",
}
_BY_NUMBER = {(mode.main, mode.sub): mode for mode in Mode}
_MAIN_MODES = frozenset(mode.main for mode in Mode)


def find_mode(main: int, sub: int) -> Mode | None:
    """Return the mode with these numbers; the sub mode counts for AUTO (4) only."""
    if (main, sub) == (4, 0):
        return Mode.MISSION
    return _BY_NUMBER.get((main, sub if main == 4 else 0))


def find_base_mode(base_mode: int) -> Mode | None:
    """Return the mode that a base mode without the custom bit means."""
    if base_mode & MODE_AUTO:
        return Mode.MISSION
    if not base_mode & MODE_MANUAL_INPUT:
        return None
    if base_mode & MODE_GUIDED:
        return Mode.POSCTL
    return Mode.STABILIZED if base_mode & MODE_STABILIZE else Mode.MANUAL


def knows_main_mode(main: int) -> bool:
    """Return whether ``main`` is a main mode at all."""
    return main in _MAIN_MODES
