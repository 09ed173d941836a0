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
_TIGHTENINGS = np.array([1.0, 0.8, 0.6, 0.4, 0.2, 0.0])
_FAN_ANGLES_RAD = np.radians([15.0, 30.0, 50.0, 70.0, 90.0, 110.0, 140.0])
_FAN_AZIMUTHS_RAD = np.arange(12) * (2.0 * np.pi / 12.0)
_FAN_SPEEDS = (1.0, 0.5)
_ALONG_SPEEDS = np.array([0.8, 0.6, 0.4, 0.2, -0.3])
_TINY = 1e-9
VERTICAL_WEIGHT = 0.5
"""How much a change of the vertical speed counts beside one of the horizontal: where a roof is
in the way, over it is a way, and slower is none."""
_WEIGHTS = np.array([1.0, 1.0, VERTICAL_WEIGHT])
_DIAGONAL = np.arange(3)


def _active_sets(num_walls: int) -> tuple[npt.NDArray[np.intp], FloatArray]:
    """Return every set of up to three of the walls, and which of its three places count.

    Shapes ``(S, 3)`` each; a place that does not count holds wall 0.
    """
    sets = [
        active
        for size in range(min(num_walls, 3) + 1)
        for active in combinations(range(num_walls), size)
    ]
    places = np.array([(*active, 0, 0, 0)[:3] for active in sets], dtype=np.intp)
    counts = np.array([[float(place < len(active)) for place in range(3)] for active in sets])
    return places, counts


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


def nearest_first(velocity_enu_mps: FloatArray, wish_enu_mps: FloatArray) -> FloatArray:
    """Return velocities ``(K, 3)`` in the order of their distance from a wish ``(3,)``."""
    offset = (velocity_enu_mps - wish_enu_mps) * _WEIGHTS
    order = np.einsum("ki,ki->k", offset, offset).argsort(kind="stable")
    return np.asarray(velocity_enu_mps[order])


def within_walls(wish_enu_mps: FloatArray, normal: FloatArray, least_mps: FloatArray) -> FloatArray:
    """Return the nearest velocities that keep all walls, for tighter and tighter caps.

    Nearest to a wish within half-spaces is a point on one, two or three of their faces: all of
    them are tried. Vertical changes count less: ``VERTICAL_WEIGHT``.

    Args:
        wish_enu_mps: Near which, shape ``(W, 3)``.
        normal: Unit normals pointing away from the walls, shape ``(M, 3)``, ``M <= MAX_WALLS``.
        least_mps: Least speed along each normal, shape ``(M,)``: negative where the vehicle may
            come nearer, positive where it must move away.

    Returns:
        Shape ``(n, 3)``, those of the first wish first; fewer where the walls contradict each
        other.
    """
    if len(normal) == 0:
        return np.zeros((0, 3))
    nearing, leaving = np.minimum(least_mps, 0.0), np.maximum(least_mps, 0.0)
    bounds = np.concatenate((_TIGHTENINGS[:, None] * nearing + leaving, [nearing]))
    places, counts = _ACTIVE_SETS[len(normal)]
    # In a space whose vertical axis is shortened by the weight, nearest is as usual.
    faces = (normal / _WEIGHTS)[places] * counts[..., None]
    gram = faces @ faces.swapaxes(1, 2)
    gram[:, _DIAGONAL, _DIAGONAL] += 1.0 + _TINY - counts
    onto = np.linalg.inv(gram) @ faces  # (S, 3, 3): from missing speeds to velocity

    gap_mps = bounds[None] - (wish_enu_mps @ normal.T)[:, None]  # (W, T, M)
    gap_mps = gap_mps.reshape(-1, len(normal))
    push = (gap_mps[:, places].swapaxes(0, 1) * counts[:, None]) @ onto  # (S, W * T, 3)
    distance = np.einsum("sri,sri->sr", push, push)
    push /= _WEIGHTS
    velocity = push + wish_enu_mps.repeat(len(bounds), axis=0)
    gained = push.reshape(-1, 3) @ normal.T
    kept = (gained.reshape(*distance.shape, -1) >= gap_mps - 1e-6).all(axis=-1)
    distance[~kept] = np.inf
    nearest = distance.argmin(axis=0)
    rows = np.arange(len(nearest))
    solved = distance[nearest, rows] < np.inf
    return np.asarray(velocity[nearest, rows][solved])
