"""An inspection as a table that reads well at 80 columns."""

from companion.inspection import Inspection
from companion.table import row


def table(seen: Inspection) -> str:
    """Return the inspection in words, the verdict last."""
    rows = [
        ("Link", seen.link),
        ("Vehicle", f"system {seen.system_id}, {seen.autopilot} {seen.version}".rstrip()),
        ("Mode", f"{seen.mode or 'unknown'}, {_armed(seen)}, {seen.landed or 'unknown'}"),
        ("Ready to arm", _yes(seen.ready_to_arm)),
        ("Battery", _text("{:.0f} %", _percent(seen.battery_fraction))),
        ("Position", _position(seen)),
        ("Heartbeat", _text("at most {:.2f} s old", seen.heartbeat_age_max_s)),
        ("Packets lost", _text("{:.2f} %", seen.link_loss_percent)),
        ("Local origin", _origin(seen)),
        ("Frame tie", _tie(seen)),
        ("On map", _place(f"{seen.map} at", seen.position_enu_m)),
        ("Target", _target(seen)),
        ("Parameters", _parameters(seen)),
        ("Failsafe", _sentence(seen.failsafe)),
        *(("", _sentence(note)) for note in seen.failsafe_notes),
        ("Blind travel", _blind(seen)),
        *(("Warning", warning) for warning in seen.warnings),
    ]
    lines = ["Preflight", *(line for name, value in rows for line in row(name, value))]
    if seen.go:
        return "\n".join([*lines, *row("Verdict", "GO")])
    reasons = [line for reason in seen.reasons for line in row("", f"- {reason}")]
    return "\n".join([*lines, *row("Verdict", "NO-GO"), *reasons])


def _sentence(words: str) -> str:
    return f"{words[0].upper()}{words[1:]}."


def _armed(seen: Inspection) -> str:
    return "armed" if seen.armed else "disarmed"


def _yes(value: bool | None) -> str:
    return "unknown" if value is None else "yes" if value else "no"


def _percent(fraction: float | None) -> float | None:
    return None if fraction is None else 100.0 * fraction


def _position(seen: Inspection) -> str:
    if seen.position_age_max_s is None:
        return "none heard"
    vouched = "the estimator vouches for it" if seen.position_valid else "NOT vouched for"
    return f"{seen.position_rate_hz:.1f} Hz, at most {seen.position_age_max_s:.2f} s old, {vouched}"


def _origin(seen: Inspection) -> str:
    if seen.local_origin is None:
        return "unknown"
    latitude_deg, longitude_deg, altitude_m = seen.local_origin
    return f"{latitude_deg:.7f}, {longitude_deg:.7f}, {altitude_m:.1f} m AMSL"


def _tie(seen: Inspection) -> str:
    if seen.tie_residual_m is None:
        return "LOCAL_POSITION_NED not checked against GLOBAL_POSITION_INT"
    return (
        f"LOCAL_POSITION_NED and GLOBAL_POSITION_INT agree within {seen.tie_residual_m:.2f} m "
        "(median)"
    )


def _place(name: str, position_enu_m: list[float] | None) -> str:
    if position_enu_m is None:
        return f"{name} an unknown place"
    return f"{name} ({', '.join(f'{metres:.1f}' for metres in position_enu_m)}) m"


def _target(seen: Inspection) -> str:
    if seen.target_enu_m is None:
        return "none yet; DO_REPOSITION addressed to the companion sets one"
    distance = _text(", {:.1f} m away", seen.target_distance_m)
    return _place("at", seen.target_enu_m) + ("" if distance == "unknown" else distance)


def _parameters(seen: Inspection) -> str:
    values = [f"{name} {_number(value)}" for name, value in seen.parameters.items()]
    return ", ".join([*values, *(f"{name} (assumed)" for name in seen.assumed)])


def _number(value: int | float) -> str:
    """Return a value so that its type shows: ``3`` is an integer, ``3.0`` is not."""
    return str(value) if isinstance(value, int) else str(float(f"{value:.6g}"))


def _blind(seen: Inspection) -> str:
    return (
        f"{seen.blind_travel_m:.1f} m at {seen.v_max_mps:g} m/s; the margin is {seen.margin_m:g} m"
    )


def _text(form: str, value: float | None) -> str:
    return "unknown" if value is None else form.format(value)
