"""Velocities near a proposal that may be safe. Which of them are, the shield checks itself.

Two sources. The exact one treats every nearby surface as a wall without end, with a largest
speed toward it: the nearest velocity within all of these half-spaces, for caps from full to
nothing. The coarse one is a fan of directions around the proposal, for scenes in which the walls
are not endless: around corners, through gaps, out of concave corners.
"""

from itertools import combinations

import numpy as np
import numpy.typing as npt

from companion.arrays import FloatArray

MAX_WALLS = 8
_TIGHTENINGS = np.array([1.0, 0.85, 0.7, 0.55, 0.4, 0.25, 0.1, 0.0])
_FAN_ANGLES_RAD = np.radians([15.0, 30.0, 50.0, 70.0, 90.0, 110.0, 140.0])
_FAN_AZIMUTHS_RAD = np.arange(12) * (2.0 * np.pi / 12.0)
_FAN_SPEEDS = (1.0, 0.5)
_ALONG_SPEEDS = np.array([0.8, 0.6, 0.4, 0.2, -0.3])
_TINY = 1e-9


def _active_sets(num_walls: int) -> tuple[npt.NDArray[np.intp], ...]:
    """Return every set of one, two or three of the walls, each kind as an array of indices."""
    return tuple(
        np.array(list(combinations(range(num_walls), size)), dtype=np.intp).reshape(-1, size)
        for size in (1, 2, 3)
        if size <= num_walls
    )


_ACTIVE_SETS = tuple(_active_sets(num_walls) for num_walls in range(MAX_WALLS + 1))


def _fan_directions() -> FloatArray:
    """Return unit directions around +x, shape ``(n, 3)``."""
    angle, azimuth = np.meshgrid(_FAN_ANGLES_RAD, _FAN_AZIMUTHS_RAD, indexing="ij")
    around = np.stack(
        (np.cos(angle), np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth)), axis=-1
    )
    return around.reshape(-1, 3)


_FAN = _fan_directions()


def fan(proposal_enu_mps: FloatArray, least_speed_mps: float) -> FloatArray:
    """Return velocities around the proposal, slower ones along it and rest, shape ``(n, 3)``.

    Args:
        proposal_enu_mps: Shape ``(3,)``.
        least_speed_mps: Speed of the fan around a proposal that is slower.
    """
    speed_mps = float(np.sqrt(proposal_enu_mps @ proposal_enu_mps))
    forward = proposal_enu_mps / speed_mps if speed_mps > _TINY else np.array([1.0, 0.0, 0.0])
    # Left is horizontal; above or below a vertical proposal, north takes its place.
    left = np.array([-forward[1], forward[0], 0.0])
    left_length = float(np.sqrt(left @ left))
    left = left / left_length if left_length > 1e-6 else np.array([0.0, 1.0, 0.0])
    upward = np.array(
        [
            forward[1] * left[2] - forward[2] * left[1],
            forward[2] * left[0] - forward[0] * left[2],
            forward[0] * left[1] - forward[1] * left[0],
        ]
    )
    directions = _FAN @ np.stack((forward, left, upward))
    fan_mps = max(speed_mps, least_speed_mps)
    return np.concatenate(
        [
            np.zeros((1, 3)),
            _ALONG_SPEEDS[:, None] * proposal_enu_mps,
            *(share * fan_mps * directions for share in _FAN_SPEEDS),
        ]
    )


def within_walls(
    proposal_enu_mps: FloatArray, normal: FloatArray, least_mps: FloatArray
) -> FloatArray:
    """Return the nearest velocities that keep all walls, for tighter and tighter caps.

    Args:
        proposal_enu_mps: Shape ``(3,)``.
        normal: Unit normals pointing away from the walls, shape ``(M, 3)``, ``M <= MAX_WALLS``.
        least_mps: Least speed along each normal, shape ``(M,)``: negative where the vehicle may
            come nearer, positive where it must move away.

    Returns:
        Shape ``(n, 3)``; empty where the walls contradict each other.
    """
    if len(normal) == 0:
        return np.zeros((0, 3))
    nearing, leaving = np.minimum(least_mps, 0.0), np.maximum(least_mps, 0.0)
    bounds = np.concatenate((_TIGHTENINGS[:, None] * nearing + leaving, [nearing]))
    gap_mps = bounds - normal @ proposal_enu_mps
    found = [np.broadcast_to(proposal_enu_mps, (len(bounds), 1, 3))]
    for active in _ACTIVE_SETS[len(normal)]:
        normals = normal[active]
        gram = normals @ normals.swapaxes(1, 2) + _TINY * np.eye(active.shape[1])
        push = np.linalg.solve(gram, gap_mps[:, active][..., None])
        found.append(proposal_enu_mps + np.einsum("bcki,ckj->bcj", push, normals))
    velocity = np.concatenate(found, axis=1)
    kept = (velocity @ normal.T >= bounds[:, None] - 1e-6).all(axis=-1)
    offset = velocity - proposal_enu_mps
    distance = np.where(kept, np.einsum("bci,bci->bc", offset, offset), np.inf)
    nearest = np.argmin(distance, axis=1)
    rows = np.arange(len(bounds))
    solved = np.isfinite(distance[rows, nearest])
    return np.asarray(velocity[rows, nearest][solved])
