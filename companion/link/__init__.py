"""The MAVLink link: bytes on one side, ``companion.vehicle`` on the other.

Reading order: ``address`` (URLs), ``transport`` (sockets and ports), ``codec`` (packets),
``autopilots`` (what differs between PX4 and ArduPilot), ``telemetry`` and ``requests`` (state
and commands, without I/O), ``discovery``, ``vehicle``.
"""
