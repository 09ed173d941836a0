"""Every kind of fault: what it reads from its specification and what it does to the vehicle.

A *plan* reads the values, so that a wrong one is refused at the start; it returns the *act*
that is run when the time has come, and the act returns how to *undo* it, or ``None``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sim.mock.dynamics import ZERO, Vector
from sim.mock.estimator import subtract
from sim.mock.intruder import Intruder
from sim.mock.specs import Spec

if TYPE_CHECKING:
    from sim.mock.targets import Target
    from sim.mock.vehicle import MockVehicle
    from sim.mock.wire import Impairment

Undo = Callable[[], None]
Act = Callable[["MockVehicle"], Undo | None]
Plan = Callable[[Spec], Act]


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of fault: its plan, the keys it knows and what it means."""

    plan: Plan
    keys: tuple[str, ...]
    meaning: str


def _rc_takeover(spec: Spec) -> Act:
    mode = spec.word("mode")

    def act(vehicle: "MockVehicle") -> None:
        autopilot = vehicle.autopilot
        autopilot.choose_mode(mode or autopilot.takeover_mode, by_pilot=True)

    return act


def _gcs_mode(spec: Spec) -> Act:
    mode = spec.word("mode")

    def act(vehicle: "MockVehicle") -> None:
        autopilot = vehicle.autopilot
        autopilot.choose_mode(mode or autopilot.hold_mode, by_pilot=False)

    return act


def _rc_loss(spec: Spec) -> Act:
    def act(vehicle: "MockVehicle") -> Undo:
        autopilot = vehicle.autopilot
        autopilot.lose_radio(lost=True)
        return lambda: autopilot.lose_radio(lost=False)

    return act


def _gps_glitch(spec: Spec) -> Act:
    step = (0.0, spec.number("size", 15.0), 0.0)

    def act(vehicle: "MockVehicle") -> Undo:
        autopilot = vehicle.autopilot
        autopilot.mislead(step)
        autopilot.estimator.glitching = True

        def over() -> None:
            autopilot.mislead(subtract(ZERO, step))
            autopilot.estimator.glitching = False

        return over

    return act


def _gps_loss(spec: Spec) -> Act:
    def act(vehicle: "MockVehicle") -> Undo:
        autopilot = vehicle.autopilot
        autopilot.lose_gps(lost=True)
        return lambda: autopilot.lose_gps(lost=False)

    return act


def _shift(spec: Spec, north_m: float) -> Vector:
    return spec.number("north", north_m), spec.number("east", 0.0), spec.number("down", 0.0)


def _ekf_reset(spec: Spec) -> Act:
    step_m = _shift(spec, 3.0)

    def act(vehicle: "MockVehicle") -> None:
        vehicle.autopilot.reset_estimate(step_m)

    return act


def _origin_move(spec: Spec) -> Act:
    shift_m = _shift(spec, 10.0)

    def act(vehicle: "MockVehicle") -> None:
        vehicle.autopilot.estimator.move_origin(shift_m)

    return act


def _setpoint_deaf(spec: Spec) -> Act:
    def act(vehicle: "MockVehicle") -> Undo:
        autopilot = vehicle.autopilot
        autopilot.deaf = True
        return lambda: setattr(autopilot, "deaf", False)

    return act


def _battery(level: float) -> Plan:
    """Return the plan of a fault that leaves so much in the battery."""

    def plan(spec: Spec) -> Act:
        left = spec.number("level", level, low=0.0, high=1.0)

        def act(vehicle: "MockVehicle") -> None:
            vehicle.autopilot.battery.fraction = left

        return act

    return plan


def _geofence(spec: Spec) -> Act:
    radius_m = spec.number("radius", 20.0, low=1.0)

    def act(vehicle: "MockVehicle") -> Undo:
        autopilot = vehicle.autopilot
        autopilot.fence_in(radius_m)
        return lambda: autopilot.fence_in(0.0)

    return act


def _reboot(spec: Spec) -> Act:
    def act(vehicle: "MockVehicle") -> None:
        vehicle.reboot()

    return act


def _second_companion(spec: Spec) -> Act:
    component = int(min(255.0, spec.number("compid", 192.0, low=1.0)))
    speed_mps = spec.number("speed", 1.0)

    def act(vehicle: "MockVehicle") -> Undo:
        vehicle.intruder = Intruder(
            vehicle.settings.system_id, component, speed_mps, vehicle.time_s
        )
        return lambda: setattr(vehicle, "intruder", None)

    return act


def _link_fault(change: Callable[[Spec], dict[str, float]]) -> Plan:
    """Return the plan of a fault that sets attributes of link impairments."""

    def plan(spec: Spec) -> Act:
        values = change(spec)
        number = int(spec.number("link", 0.0, low=1.0))  # counted from 1; 0 is all of them

        def act(vehicle: "MockVehicle") -> Undo:
            states = vehicle.impairments
            chosen: list[Impairment] = states if number == 0 else [states[number - 1]]

            def put(target: dict[str, float]) -> None:
                for state in chosen:
                    for name, value in target.items():
                        setattr(state, name, value)

            put(values)
            return lambda: put(dict.fromkeys(values, 0.0))

        return act

    return plan


def _percent(name: str) -> Plan:
    return _link_fault(
        lambda spec: {name: spec.number("percent", 5.0, low=0.0, high=100.0) / 100.0}
    )


def _delay(spec: Spec) -> dict[str, float]:
    late_s = spec.number("ms", 200.0, low=0.0) / 1e3
    return {"delay_s": late_s, "jitter_s": spec.number("jitter_ms", 0.0, low=0.0) / 1e3}


def _reorder(spec: Spec) -> dict[str, float]:
    return {"jitter_s": spec.number("ms", 100.0, low=0.0) / 1e3}


def _ack_lost(spec: Spec) -> Act:
    count = int(spec.number("count", 1.0, low=1.0))

    def act(vehicle: "MockVehicle") -> None:
        for state in vehicle.impairments:
            state.acks_to_lose += count

    return act


def _slow_acks(*, progress: bool) -> Plan:
    """Return the plan of a fault that delays the answers to commands."""

    def plan(spec: Spec) -> Act:
        delay_s = spec.number("ms", 1500.0, low=0.0) / 1e3

        def act(vehicle: "MockVehicle") -> Undo:
            def put(delay_s: float, *, progress: bool) -> None:
                for channel in vehicle.channels:
                    channel.ack_delay_s, channel.ack_progress = delay_s, progress

            put(delay_s, progress=progress)
            return lambda: put(0.0, progress=False)

        return act

    return plan


def _target_fault(
    change: Callable[["Target", float], None], undo: Callable[["Target"], None]
) -> Plan:
    """Return the plan of a fault of one target, or of all."""

    def plan(spec: Spec) -> Act:
        sysid = int(spec.number("sysid", 0.0, low=1.0))

        def act(vehicle: "MockVehicle") -> Undo:
            chosen = [target for target in vehicle.targets if sysid in (0, target.sysid)]
            for target in chosen:
                change(target, vehicle.time_s)

            def back() -> None:
                for target in chosen:
                    undo(target)

            return back

        return act

    return plan


def _target_jump(spec: Spec) -> Act:
    step = (spec.number("east", 40.0), spec.number("north", 0.0), spec.number("up", 0.0))
    plan = _target_fault(
        lambda target, now_s: setattr(target, "jump_enu_m", step),
        lambda target: setattr(target, "jump_enu_m", ZERO),
    )
    return plan(spec)


def _target_clash(spec: Spec) -> Act:
    step = (spec.number("east", 40.0), spec.number("north", 0.0), spec.number("up", 0.0))
    plan = _target_fault(
        lambda target, now_s: setattr(target, "double_enu_m", step),
        lambda target: setattr(target, "double_enu_m", None),
    )
    return plan(spec)


_target_stale = _target_fault(
    lambda target, now_s: setattr(target, "silent", True),
    lambda target: setattr(target, "silent", False),
)
_target_freeze = _target_fault(
    lambda target, now_s: setattr(target, "frozen_s", now_s),
    lambda target: setattr(target, "frozen_s", None),
)

_SHIFT = ("north", "east", "down")
_SHARE = ("percent", "link")
KINDS: dict[str, Kind] = {
    "rc_takeover": Kind(_rc_takeover, ("mode",), "the pilot switches to posctl; ArduPilot: loiter"),
    "rc_loss": Kind(_rc_loss, (), "the transmitter falls silent (with --radio)"),
    "gcs_mode": Kind(_gcs_mode, ("mode",), "the ground station chooses loiter; ArduPilot: brake"),
    "gps_glitch": Kind(_gps_glitch, ("size",), "the estimate steps 15 m east, flag set"),
    "gps_loss": Kind(_gps_loss, (), "no fix; 5.3 s later no position"),
    "ekf_reset": Kind(_ekf_reset, _SHIFT, "reset_counter + 1, the estimate steps 3 m north"),
    "origin_move": Kind(_origin_move, _SHIFT, "the local origin moves 10 m north"),
    "setpoint_deaf": Kind(_setpoint_deaf, (), "setpoints no longer reach the autopilot"),
    "battery_low": Kind(_battery(0.1), ("level",), "the battery drops to level 0.1"),
    "battery_critical": Kind(_battery(0.06), ("level",), "the battery drops to level 0.06"),
    "geofence": Kind(_geofence, ("radius",), "a fence of 20 m around home"),
    "reboot": Kind(_reboot, (), "the autopilot restarts; in the air it falls"),
    "second_companion": Kind(
        _second_companion, ("compid", "speed"), "1/192 streams setpoints too, 1 m/s north"
    ),
    "link_loss": Kind(_link_fault(lambda spec: {"cut": 1.0}), ("link",), "nothing passes"),
    "loss": Kind(_percent("loss"), _SHARE, "5 percent of the packets are lost"),
    "duplicate": Kind(_percent("duplicate"), _SHARE, "5 percent arrive twice"),
    "corrupt": Kind(_percent("corrupt"), _SHARE, "5 percent arrive with a wrong byte"),
    "delay": Kind(_link_fault(_delay), ("ms", "jitter_ms", "link"), "200 ms late; jitter reorders"),
    "reorder": Kind(
        _link_fault(_reorder), ("ms", "link"), "up to 100 ms late: packets overtake each other"
    ),
    "ack_lost": Kind(_ack_lost, ("count",), "the next 1 COMMAND_ACK is lost"),
    "ack_late": Kind(_slow_acks(progress=False), ("ms",), "COMMAND_ACK comes 1500 ms late"),
    "in_progress": Kind(
        _slow_acks(progress=True), ("ms",), "IN_PROGRESS first, the answer 1500 ms later"
    ),
    "target_stale": Kind(_target_stale, ("sysid",), "targets fall silent"),
    "target_freeze": Kind(_target_freeze, ("sysid",), "targets repeat one report for ever"),
    "target_jump": Kind(_target_jump, ("sysid", "east", "north", "up"), "targets jump 40 m east"),
    "target_clash": Kind(
        _target_clash,
        ("sysid", "east", "north", "up"),
        "another system with the same id, 40 m east",
    ),
}
