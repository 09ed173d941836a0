"""The firmware's own words for flight modes, of every kind of vehicle."""

from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.link.autopilots import Px4

_PX4 = Px4()
_FIXED_WING = (dialect.MAV_TYPE_FIXED_WING, *range(19, 26))  # and the VTOLs
_ROVERS = (dialect.MAV_TYPE_GROUND_ROVER, dialect.MAV_TYPE_SURFACE_BOAT)


def mode_namer(firmware: str, vehicle_type: int) -> Callable[[int], str]:
    """Return what turns ``custom_mode`` of a HEARTBEAT into a word.

    Args:
        firmware: ``px4``, ``ardupilot`` or anything else.
        vehicle_type: MAV_TYPE: ArduPilot numbers the modes of each kind its own way.
    """
    if firmware == "px4":
        return _PX4.mode_name
    if firmware != "ardupilot":
        return "mode {}".format
    if vehicle_type in _FIXED_WING:
        names = "PLANE_MODE"
    elif vehicle_type in _ROVERS:
        names = "ROVER_MODE"
    elif vehicle_type == dialect.MAV_TYPE_SUBMARINE:
        names = "SUB_MODE"
    else:
        names = "COPTER_MODE"
    enum = dialect.enums[names]

    def name(custom_mode: int) -> str:
        entry = enum.get(custom_mode)
        return f"MODE {custom_mode}" if entry is None else str(entry.name[len(names) + 1 :])

    return name


def obeys_setpoints(mode: str) -> bool:
    """Return whether setpoints fly the vehicle in this mode."""
    return mode in ("OFFBOARD", "GUIDED")
