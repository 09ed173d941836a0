"""The paper's spherical action: three numbers in [-1, 1] <-> a displacement or a velocity.

    column   quantity             from -1 to +1              zero means
    0        rho, step length     rho_min .. rho_max         half way
    1        phi, polar angle     0 (up) .. pi (down)        see ``polar_reference``
    2        psi, azimuth         the whole circle           see ``azimuth_reference``

Equation (1) of the paper, with its errata: ``y += rho sin(phi) sin(psi)`` (the paper drops
``sin(psi)`` and could never decrease y); ``phi = pi`` moves DOWN the z axis, as the equation says
and the paper's example does not; psi is the azimuth and phi the polar angle from +z.

Every function takes ``(3,)`` and ``(N, 3)`` alike. Azimuths run from map east (x) toward map
north (y).
"""

from typing import Literal

import msgspec
import numpy as np
import numpy.typing as npt

from companion.arrays import FloatArray

MIN_BEARING_DISTANCE_M = 1e-3
"""Closer than this horizontally, the target is straight above or below and has no bearing."""

AngleReference = Literal["absolute", "target"]


class ActionScaling(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What -1 and +1 of each action column mean."""

    rho_min: float = 0.0
    """Shortest step, as a fraction of the map's edge."""
    rho_max: float = 0.2
    """Longest step, as a fraction of the map's edge: Table I, read as 20 m of 100 m."""
    polar_low_rad: float = 0.0
    polar_high_rad: float = np.pi
    azimuth_low_rad: float = 0.0
    azimuth_high_rad: float = 2.0 * np.pi
    azimuth_reference: AngleReference = "absolute"
    """``absolute``: psi is measured from map east, as in the paper. ``target``: from the
    horizontal bearing to the target, so that the same action means the same thing everywhere."""
    polar_reference: AngleReference = "absolute"
    """``absolute``: zero is the middle of phi's range, as in the paper. ``target``: zero is the
    direction of the target, and the two ends are where they were."""

    def __post_init__(self) -> None:
        """Refuse ranges that are empty, reversed or not finite.

        Raises:
            ValueError: If a range is wrong; msgspec turns it into a ``ValidationError``.
        """
        numbers = (
            self.rho_min,
            self.rho_max,
            self.polar_low_rad,
            self.polar_high_rad,
            self.azimuth_low_rad,
            self.azimuth_high_rad,
        )
        if not np.isfinite(numbers).all():
            raise ValueError("action ranges must be finite")
        if not 0.0 <= self.rho_min < self.rho_max:
            raise ValueError(f"need 0 <= rho_min < rho_max, got {self.rho_min}, {self.rho_max}")
        if not 0.0 <= self.polar_low_rad < self.polar_high_rad <= np.pi + 1e-9:
            raise ValueError("polar range must lie within 0 .. pi")
        if not self.azimuth_low_rad < self.azimuth_high_rad:
            raise ValueError("azimuth range is empty")


PAPER_SCALING = ActionScaling()
"""psi absolute in [0, 2 pi], as in the paper."""

TARGET_SCALING = ActionScaling(
    azimuth_low_rad=-np.pi, azimuth_high_rad=np.pi, azimuth_reference="target"
)
"""psi from the bearing to the target in [-pi, pi]: the wrap lies behind the vehicle."""

AIM_SCALING = msgspec.structs.replace(TARGET_SCALING, polar_reference="target")
"""phi as well: the zero action flies at the target, be it straight below, where an actor would
otherwise have to hold its output at the very end of its range."""


def bearing_to_target_rad(position_enu_m: FloatArray, target_enu_m: FloatArray) -> FloatArray:
    """Return the azimuth of the target from the vehicle in (-pi, pi], shape ``(...)``.

    A target straight above or below (within ``MIN_BEARING_DISTANCE_M`` horizontally) has no
    bearing; 0 (map east) stands for it, in training and in flight alike.
    """
    offset_m = np.asarray(target_enu_m, dtype=np.float64) - position_enu_m
    has_bearing = np.hypot(offset_m[..., 0], offset_m[..., 1]) >= MIN_BEARING_DISTANCE_M
    return np.where(has_bearing, np.arctan2(offset_m[..., 1], offset_m[..., 0]), 0.0)


def polar_to_target_rad(position_enu_m: FloatArray, target_enu_m: FloatArray) -> FloatArray:
    """Return the angle of the target from straight up in [0, pi], shape ``(...)``.

    At the target itself (within ``MIN_BEARING_DISTANCE_M``) there is none; horizontal stands for
    it, in training and in flight alike.
    """
    offset_m = np.asarray(target_enu_m, dtype=np.float64) - position_enu_m
    horizontal_m, up_m = np.hypot(offset_m[..., 0], offset_m[..., 1]), offset_m[..., 2]
    has_polar = np.hypot(horizontal_m, up_m) >= MIN_BEARING_DISTANCE_M
    return np.where(has_polar, np.arctan2(horizontal_m, up_m), 0.5 * np.pi)


def to_spherical(
    action: npt.NDArray[np.floating],
    scaling: ActionScaling,
    bearing_rad: npt.NDArray[np.floating] | float = 0.0,
    polar_rad: npt.NDArray[np.floating] | float | None = None,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the physical action ``(rho, phi, psi)``, each of shape ``(...)``.

    Args:
        action: Shape ``(..., 3)``; values outside [-1, 1] count as the nearest bound.
        scaling: Ranges of the three quantities.
        bearing_rad: Bearing to the target, shape ``(...)``; used where psi is measured from it.
        polar_rad: Angle of the target from straight up, shape ``(...)``; where phi is.

    Returns:
        rho as a fraction of the edge, phi in radians from +z, psi as an absolute azimuth.

    Raises:
        ValueError: If phi is measured from the target and ``polar_rad`` is missing.
    """
    unit = 0.5 * (np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0) + 1.0)
    rho = scaling.rho_min + unit[..., 0] * (scaling.rho_max - scaling.rho_min)
    phi_rad = scaling.polar_low_rad + unit[..., 1] * (
        scaling.polar_high_rad - scaling.polar_low_rad
    )
    if scaling.polar_reference == "target":
        zero_rad = _zero_rad(scaling, polar_rad)
        turn = 2.0 * unit[..., 1] - 1.0
        phi_rad = zero_rad + turn * _room_rad(scaling, zero_rad, turn)
    psi_rad = scaling.azimuth_low_rad + unit[..., 2] * (
        scaling.azimuth_high_rad - scaling.azimuth_low_rad
    )
    if scaling.azimuth_reference == "target":
        psi_rad = psi_rad + bearing_rad
    return rho, phi_rad, psi_rad


def spherical_to_displacement(
    rho: FloatArray, phi_rad: FloatArray, psi_rad: FloatArray
) -> FloatArray:
    """Return equation (1) as errata E1 to E3 read it, shape ``(..., 3)``, in the unit of rho."""
    horizontal = rho * np.sin(phi_rad)
    return np.stack(
        (horizontal * np.cos(psi_rad), horizontal * np.sin(psi_rad), rho * np.cos(phi_rad)),
        axis=-1,
    )


def action_to_displacement_m(
    action: npt.NDArray[np.floating],
    scaling: ActionScaling,
    edge_m: float,
    bearing_rad: npt.NDArray[np.floating] | float = 0.0,
    polar_rad: npt.NDArray[np.floating] | float | None = None,
) -> FloatArray:
    """Return the step that ``action`` asks for in map ENU metres, shape ``(..., 3)``."""
    return edge_m * spherical_to_displacement(
        *to_spherical(action, scaling, bearing_rad, polar_rad)
    )


def action_to_velocity_mps(
    action: npt.NDArray[np.floating],
    scaling: ActionScaling,
    v_max_mps: float,
    bearing_rad: npt.NDArray[np.floating] | float = 0.0,
    polar_rad: npt.NDArray[np.floating] | float | None = None,
) -> FloatArray:
    """Return the velocity that ``action`` asks for in map ENU, shape ``(..., 3)``.

    The paper gives neither the step time nor the speed; with ``rho_max`` crossed in one step at
    ``v_max``, the speed is ``v_max * rho / rho_max`` and never above ``v_max``.
    """
    rho, phi_rad, psi_rad = to_spherical(action, scaling, bearing_rad, polar_rad)
    return spherical_to_displacement(v_max_mps * rho / scaling.rho_max, phi_rad, psi_rad)


def displacement_to_action(
    displacement_enu_m: FloatArray,
    scaling: ActionScaling,
    edge_m: float,
    bearing_rad: npt.NDArray[np.floating] | float = 0.0,
    polar_rad: npt.NDArray[np.floating] | float | None = None,
) -> FloatArray:
    """Return the action in [-1, 1] that comes nearest to a displacement, shape ``(..., 3)``.

    The inverse of ``action_to_displacement_m``; longer steps are shortened to ``rho_max``.
    """
    east_m, north_m, up_m = np.moveaxis(np.asarray(displacement_enu_m, dtype=np.float64), -1, 0)
    horizontal_m = np.hypot(east_m, north_m)
    rho = np.hypot(horizontal_m, up_m) / edge_m
    phi_rad = np.arctan2(horizontal_m, up_m)
    psi_rad = np.arctan2(north_m, east_m)
    if scaling.azimuth_reference == "target":
        psi_rad = psi_rad - bearing_rad
    turn_rad = 2.0 * np.pi
    psi_rad = scaling.azimuth_low_rad + np.mod(psi_rad - scaling.azimuth_low_rad, turn_rad)
    unit = np.stack(
        (
            (rho - scaling.rho_min) / (scaling.rho_max - scaling.rho_min),
            (phi_rad - scaling.polar_low_rad) / (scaling.polar_high_rad - scaling.polar_low_rad),
            (psi_rad - scaling.azimuth_low_rad)
            / (scaling.azimuth_high_rad - scaling.azimuth_low_rad),
        ),
        axis=-1,
    )
    action = 2.0 * unit - 1.0
    if scaling.polar_reference == "target":
        zero_rad = _zero_rad(scaling, polar_rad)
        room_rad = _room_rad(scaling, zero_rad, phi_rad - zero_rad)
        action[..., 1] = (phi_rad - zero_rad) / np.where(room_rad > 0.0, room_rad, 1.0)
    return np.clip(action, -1.0, 1.0)


def _zero_rad(
    scaling: ActionScaling, polar_rad: npt.NDArray[np.floating] | float | None
) -> FloatArray:
    """Return the phi that zero means, where that is the direction of the target."""
    if polar_rad is None:
        raise ValueError("phi is measured from the target: its polar angle must be given")
    return np.clip(polar_rad, scaling.polar_low_rad, scaling.polar_high_rad)


def _room_rad(scaling: ActionScaling, zero_rad: FloatArray, turn: FloatArray) -> FloatArray:
    """Return how far it is from zero to the end of phi's range on the side of a turn."""
    return np.where(turn < 0.0, zero_rad - scaling.polar_low_rad, scaling.polar_high_rad - zero_rad)
