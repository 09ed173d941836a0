"""The MAVLink link: bytes on one side, ``companion.vehicle`` on the other.

Reading order: ``address`` (URLs), ``transport`` (sockets and ports), ``codec`` (packets; ``mavsdk``
does the same by another library), ``signing``, ``connection`` (these together); ``autopilots``
(what differs between PX4 and ArduPilot), ``messages`` (what we send); ``telemetry``, ``targets``,
``requests``, ``inbox``, ``route``, ``housekeeping`` and ``parameters`` (one concern each, time as
an argument); ``discovery``, ``vehicle``, ``opening``.
"""
