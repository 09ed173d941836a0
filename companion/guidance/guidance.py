"""Vehicle, target and map -> the velocity that the policy asks for; nothing of it is trusted."""

from dataclasses import dataclass

import numpy as np

from companion.arrays import Float32Array, FloatArray
from companion.policy.action import (
    bearing_to_target_rad,
    polar_to_target_rad,
    spherical_to_displacement,
    to_spherical,
)
from companion.policy.actor import Actor
from companion.policy.observation import build_observation
from companion.world.maps import Map
from companion.world.way_ahead import WayAhead


@dataclass(frozen=True, slots=True)
class Proposal:
    """One decision of the policy, with what it was made from."""

    observation: Float32Array
    """What the actor saw, shape ``(n,)``."""
    action: Float32Array
    """What it answered, shape ``(3,)``; in [-1, 1] when the actor is sound."""
    spherical: tuple[float, float, float]
    """The answer in the paper's words: rho as a fraction of the edge, phi from +z (0 is up, pi
    is down) and psi from map east toward north, both in radians."""
    velocity_enu_mps: FloatArray
    """What it means in flight, shape ``(3,)``; NaN where the actor answered NaN."""


def propose(
    actor: Actor,
    map: Map,
    *,
    position_enu_m: FloatArray,
    velocity_enu_mps: FloatArray,
    target_enu_m: FloatArray,
    v_max_mps: float,
    ahead: WayAhead | None = None,
) -> Proposal:
    """Ask the actor where to fly.

    Args:
        actor: Has been checked against map and speed (``Actor.check_fits``).
        map: Where vehicle and target are.
        position_enu_m: Of the vehicle, shape ``(3,)``.
        velocity_enu_mps: Of the vehicle, shape ``(3,)``.
        target_enu_m: Shape ``(3,)``.
        v_max_mps: Speed of the longest step the actor can ask for: ``v_max * rho / rho_max``.
        ahead: The way ahead, for actors that see it; psi and phi are then measured from its aim.

    Returns:
        The proposal. An actor that answers with NaN gets a NaN velocity here: it is for the
        shield to hold and for the supervisor to count.
    """
    observation = build_observation(
        actor.contract.layout,
        position_enu_m=position_enu_m,
        velocity_enu_mps=velocity_enu_mps,
        target_enu_m=target_enu_m,
        map=map,
        ahead=ahead,
    )
    action = actor.act(observation)
    scaling = actor.contract.action
    aim_enu_m = target_enu_m if ahead is None else ahead.aim_enu_m
    rho, phi_rad, psi_rad = to_spherical(
        action,
        scaling,
        bearing_to_target_rad(position_enu_m, aim_enu_m),
        polar_to_target_rad(position_enu_m, aim_enu_m),
    )
    return Proposal(
        observation=observation,
        action=action,
        spherical=(float(rho), float(phi_rad), float(psi_rad)),
        velocity_enu_mps=spherical_to_displacement(
            v_max_mps * rho / scaling.rho_max, phi_rad, psi_rad
        ),
    )


def straight_at_target_mps(
    position_enu_m: FloatArray, target_enu_m: FloatArray, v_max_mps: float
) -> FloatArray:
    """Return the velocity of the baseline without an actor: straight there, at full speed.

    Args:
        position_enu_m: Shape ``(..., 3)``.
        target_enu_m: Shape ``(..., 3)``.
        v_max_mps: Speed, kept up to the target itself; at the target the answer is zero.
    """
    offset_m = target_enu_m - position_enu_m
    distance_m = np.sqrt(np.einsum("...i,...i->...", offset_m, offset_m))[..., None]
    return v_max_mps * offset_m / np.where(distance_m > 0.0, distance_m, 1.0)
