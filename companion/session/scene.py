"""What stands still in the 3-D view: ground, obstacles, geofence, and the shapes that move.

Coordinates are the map's: ENU, z up. The shape of the vehicle is in its body frame, x forward,
y left, z up, and drawn several times its size: a real one would be a speck in its city.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr
import shapely

from companion.arrays import FloatArray, IntArray
from companion.session import colors
from companion.session.colors import Color
from companion.session.records import MapRecord, Mark

VEHICLE_SIZE = 0.022
"""Arm of the drawn vehicle as a fraction of the map's longest side."""
_ALARMING = ("closest", "stood down", "holding", "contact")
_TO_WHAT = " to an obstacle"
_LEAVING = "handing over"  # to be read as: this is why
_MARK_ROOM = 0.06  # of the map's edge
_CIRCLE = 24  # corners of a drawn circle
_LOW_COLOR = np.array([96, 108, 130])
_HIGH_COLOR = np.array([160, 168, 190])
_BUILDING_ALPHA = 125


def draw_map(stream: rr.RecordingStream, record: MapRecord) -> None:
    """Log the map; everything static."""
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    east_m, north_m, up_m = record.size_m
    corners_m = np.array([[0, 0], [east_m, 0], [east_m, north_m], [0, north_m]], dtype=float)
    stream.log("world/map/ground", _ground(corners_m), static=True)
    stream.log("world/map/grid", _grid(east_m, north_m), static=True)
    stream.log("world/map/geofence", _fence(corners_m, up_m), static=True)
    stream.log("world/map/north", _compass(record.size_m), static=True)
    tallest_m = max(record.heights_m, default=1.0)
    outlines: list[FloatArray] = []
    for index, (ring, height_m) in enumerate(
        zip(record.footprints_m, record.heights_m, strict=True)
    ):
        name = record.names[index] if index < len(record.names) else f"obstacle {index + 1}"
        footprint_m = np.array(ring, dtype=float)
        shade = _LOW_COLOR + (height_m / tallest_m) * (_HIGH_COLOR - _LOW_COLOR)
        stream.log(
            f"world/map/obstacles/{rr.escape_entity_path_part(name)}",
            _prism(footprint_m, height_m, [*shade.astype(int).tolist(), _BUILDING_ALPHA]),
            rr.AnyValues(name=name, height_m=height_m),
            static=True,
        )
        outlines += _edges(footprint_m, height_m)
    stream.log(
        "world/map/outlines",
        rr.LineStrips3D(outlines, colors=[(*colors.OUTLINE, 200)], radii=rr.Radius.ui_points(1.0)),
        static=True,
    )


def vehicle_shapes(edge_m: float) -> dict[str, rr.AsComponents]:
    """Return the vehicle on a map of ``edge_m``: its body, and a dot that is seen from afar."""
    return {"body": _quadrotor(VEHICLE_SIZE * edge_m), "dot": _dot(colors.BODY)}


def marks(records: Sequence[Mark], edge_m: float) -> rr.Points3D:
    """Return labelled points, red for what went wrong or nearly so; those of one place share one.

    Args:
        records: What is marked, oldest first.
        edge_m: Longest side of the map; labels nearer than a part of it would overlap.
    """
    places: list[list[Mark]] = []
    for record in records:
        for together in places:
            apart_m = np.subtract(record.position_enu_m, together[0].position_enu_m)
            if np.linalg.norm(apart_m) < _MARK_ROOM * edge_m:
                together.append(record)
                break
        else:
            places.append([record])
    alarming = [any(one.label.startswith(_ALARMING) for one in place) for place in places]
    return rr.Points3D(
        [place[0].position_enu_m for place in places],
        radii=rr.Radius.ui_points(5.0),
        colors=[colors.DANGER if alarm else colors.BODY for alarm in alarming],
        labels=["\n".join(_short(one.label) for one in place) for place in places],
        show_labels=True,
    )


def _short(label: str) -> str:
    """Return a label, ``phase [reason]``, in as few words as tell it: labels hide each other."""
    phase, _, code = label.removesuffix(_TO_WHAT).partition(" [")
    reason = code.rstrip("]").replace("_", " ")
    if phase == _LEAVING:
        return reason
    return f"{phase}: {reason}" if reason not in ("", phase) else phase


def line_style(color: Color | tuple[int, int, int, int], width: float) -> rr.AsComponents:
    """Return colour and width, in points on the screen, of a line logged without."""
    return rr.LineStrips3D.from_fields(colors=[color], radii=rr.Radius.ui_points(width))


def _dot(color: Color) -> rr.Points3D:
    return rr.Points3D([[0.0, 0.0, 0.0]], radii=rr.Radius.ui_points(4.0), colors=[color])


def _quadrotor(arm_m: float) -> rr.LineStrips3D:
    """Return four rotors on two arms, the front ones green, and a nose."""
    side_m = arm_m / np.sqrt(2.0)
    rotors_m = [np.array([x, y, 0.0]) for x in (side_m, -side_m) for y in (side_m, -side_m)]
    strips = [np.array([rotors_m[0], rotors_m[3]]), np.array([rotors_m[1], rotors_m[2]])]
    strips += [rotor_m + circle(0.55 * arm_m) for rotor_m in rotors_m]
    strips.append(np.array([[0.0, 0.0, 0.0], [1.3 * arm_m, 0.0, 0.0]]))
    white, front, rear = colors.BODY, colors.SENT, colors.MEASURED
    return rr.LineStrips3D(
        strips,
        colors=[white, white, front, front, rear, rear, white],
        radii=0.07 * arm_m,
    )


def _ground(corners_m: FloatArray) -> rr.Mesh3D:
    lowered_m = np.column_stack((corners_m, np.full(len(corners_m), -0.05)))
    return rr.Mesh3D(
        vertex_positions=lowered_m,
        triangle_indices=[[0, 1, 2], [0, 2, 3]],
        vertex_normals=np.tile([0.0, 0.0, 1.0], (4, 1)),
        albedo_factor=[*colors.GROUND, 255],
    )


def _fence(corners_m: FloatArray, top_m: float) -> rr.LineStrips3D:
    return rr.LineStrips3D(
        _edges(corners_m, top_m), colors=[colors.FENCE], radii=rr.Radius.ui_points(0.5)
    )


def _grid(east_m: float, north_m: float) -> rr.LineStrips3D:
    """Return lines on the ground, ten to the longer side."""
    spacing_m = max(east_m, north_m) / 10.0
    lines = [[[x, 0.0, 0.0], [x, north_m, 0.0]] for x in np.arange(0.0, east_m, spacing_m)]
    lines += [[[0.0, y, 0.0], [east_m, y, 0.0]] for y in np.arange(0.0, north_m, spacing_m)]
    return rr.LineStrips3D(lines, colors=[colors.GRID], radii=rr.Radius.ui_points(0.5))


def _compass(size_m: list[float]) -> rr.Arrows3D:
    east_m, north_m, _ = size_m
    length_m = 0.08 * max(east_m, north_m)
    return rr.Arrows3D(
        origins=[[0.5 * east_m, north_m + 0.3 * length_m, 0.0]],
        vectors=[[0.0, length_m, 0.0]],
        colors=[colors.LIMIT],
        radii=0.08 * length_m,
        labels=["N"],
        show_labels=True,
    )


def circle(radius_m: float) -> FloatArray:
    """Return a level circle round the origin, closed, shape ``(N, 3)``."""
    angle_rad = np.linspace(0.0, 2.0 * np.pi, _CIRCLE + 1)
    return radius_m * np.stack((np.cos(angle_rad), np.sin(angle_rad), 0.0 * angle_rad), axis=-1)


def _edges(footprint_m: FloatArray, height_m: float) -> list[FloatArray]:
    """Return bottom ring, top ring and the upright edges of a prism."""
    ring_m = np.vstack((footprint_m, footprint_m[:1]))
    bottom_m = np.column_stack((ring_m, np.zeros(len(ring_m))))
    top_m = np.column_stack((ring_m, np.full(len(ring_m), height_m)))
    uprights = [np.stack((low, high)) for low, high in zip(bottom_m[:-1], top_m[:-1], strict=True)]
    return [bottom_m, top_m, *uprights]


def _prism(footprint_m: FloatArray, height_m: float, color: list[int]) -> rr.Mesh3D:
    """Return walls and roof with flat shading, for any simple footprint."""
    roof_m, roof_triangles = _roof(footprint_m, height_m)
    positions = [roof_m]
    normals = [np.tile([0.0, 0.0, 1.0], (len(roof_m), 1))]
    triangles = [roof_triangles]
    start = len(roof_m)
    for wall_m, normal in _walls(footprint_m, height_m):
        positions.append(wall_m)
        normals.append(np.tile(normal, (4, 1)))
        triangles.append(start + np.array([[0, 1, 2], [0, 2, 3]]))
        start += 4
    return rr.Mesh3D(
        vertex_positions=np.vstack(positions),
        vertex_normals=np.vstack(normals),
        triangle_indices=np.vstack(triangles),
        albedo_factor=color,
    )


def _walls(footprint_m: FloatArray, height_m: float) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield the four corners and the outward normal of each wall."""
    if not shapely.is_ccw(shapely.linearrings(footprint_m)):
        footprint_m = footprint_m[::-1]
    for start_m, end_m in zip(footprint_m, np.roll(footprint_m, -1, axis=0), strict=True):
        along_m = end_m - start_m
        length_m = np.hypot(*along_m)
        if length_m == 0.0:  # rings may be closed by repeating the first vertex
            continue
        corners_m = np.array([[*start_m, 0], [*end_m, 0], [*end_m, height_m], [*start_m, height_m]])
        yield corners_m, np.array([along_m[1], -along_m[0], 0.0]) / length_m


def _roof(footprint_m: FloatArray, height_m: float) -> tuple[FloatArray, IntArray]:
    """Triangulate the footprint, concave or not, and lift it; triangles face up."""
    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(shapely.Polygon(footprint_m)))
    corners_m = np.vstack([shapely.get_coordinates(part.normalize())[:3] for part in parts])
    # a normalised ring runs clockwise: reversed, it is seen from above
    triangles = np.arange(len(corners_m), dtype=np.int64).reshape(-1, 3)[:, ::-1]
    return np.column_stack((corners_m, np.full(len(corners_m), height_m))), triangles
