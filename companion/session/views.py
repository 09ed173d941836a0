"""The views a layout is made of: scenes, plots, and the window of time they show."""

import math
from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.archetypes import VisibleTimeRanges

from companion.arrays import FloatArray
from companion.session import colors, curves
from companion.session.curves import Curve
from companion.session.records import MapRecord, SessionStart

_LIVE_WINDOW_S = 60.0
ALWAYS = rrb.TimeRange(start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.infinite())
_WHOLE = rrb.VisibleTimeRange("session", start=ALWAYS.start, end=ALWAYS.end)
_PATH_WIDTHS = {"vehicle": 2.5, "target": 1.2}
LAST_MINUTE = rrb.TimeRange(
    start=rrb.TimeRangeBoundary.cursor_relative(seconds=-_LIVE_WINDOW_S),
    end=rrb.TimeRangeBoundary.cursor_relative(),
)
_EQUATOR_M = 40_075_017.0
_MAP_SHARE = 1.5  # tiles, of 256 pixels, from border to border
_CLOSEST_ZOOM = 19.0  # of OpenStreetMap
_HEADROOM = 1.12  # for the pole of the target
_UP = (0.0, 0.0, 1.0)
_AZIMUTH_RAD = 0.85  # of the city camera, from east toward north
_DIVE_RAD = 0.6  # below the horizon
SLOPE_UP = 0.94 * math.tan(0.5 * math.radians(55.0))  # the viewer's field of view, less a rim
SLOPE_ACROSS = 1.5 * SLOPE_UP  # the view is at least that much wider than high


def city_view(city: MapRecord, name: str = "City") -> rrb.Spatial3DView:
    """See the whole map from the south-west, high enough to look into the streets."""
    east_m, north_m, up_m = city.size_m
    shown_m = [[east, north, 0.0] for east in (0.0, east_m) for north in (0.0, north_m)]
    if not city.footprints_m:
        shown_m += [[*corner[:2], up_m] for corner in shown_m]
    for ring, height_m in zip(city.footprints_m, city.heights_m, strict=True):
        shown_m += [[east, north, _HEADROOM * height_m] for east, north in ring]
    eye_m, centre_m = stand_back(np.array(shown_m))
    eye = rrb.EyeControls3D(position=eye_m, look_target=centre_m, eye_up=_UP)
    return _scene(name, eye)


def stand_back(shown_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where to stand and where to look, so that all points ``(N, 3)`` are in view."""
    level = np.array([math.cos(_AZIMUTH_RAD), math.sin(_AZIMUTH_RAD), 0.0])
    right = np.array([level[1], -level[0], 0.0])
    ahead = math.cos(_DIVE_RAD) * level - math.sin(_DIVE_RAD) * np.array(_UP)
    above = np.cross(right, ahead)
    across_m, up_m, depth_m = (shown_m @ axis for axis in (right, above, ahead))
    centre, back_m = [], []
    for offset_m, slope in ((across_m, SLOPE_ACROSS), (up_m, SLOPE_UP)):
        low_m, high_m = (offset_m + slope * depth_m).min(), (offset_m - slope * depth_m).max()
        back_m.append((high_m - low_m) / (2.0 * slope))
        centre.append(0.5 * (high_m + low_m))
    distance_m = max(back_m)
    eye_m = centre[0] * right + centre[1] * above - distance_m * ahead
    return eye_m, eye_m + (distance_m + depth_m.mean()) * ahead  # orbits turn round the middle


def plan_view(city: MapRecord) -> rrb.Spatial2DView:
    """See the plan, north up, with a rim around it."""
    east_m, north_m, _ = city.size_m
    rim_m = 0.05 * max(east_m, north_m)
    return rrb.Spatial2DView(
        origin="plan",
        name="Plan",
        background=rrb.Background(kind=rrb.BackgroundKind.SolidColor, color=colors.BACKGROUND),
        visual_bounds=rrb.VisualBounds2D(
            x_range=(-rim_m, east_m + rim_m), y_range=(-north_m - rim_m, rim_m)
        ),
        overrides={
            f"plan/path/{who}": [
                VisibleTimeRanges([_WHOLE]),
                rr.LineStrips2D.from_fields(radii=rr.Radius.ui_points(width)),
            ]
            for who, width in _PATH_WIDTHS.items()
        },
    )


def earth_view(city: MapRecord) -> rrb.MapView:
    """See the place on earth; the picture below the lines needs a network."""
    latitude_rad = math.radians(city.origin[0] if city.origin is not None else 0.0)
    metres_m = _EQUATOR_M * math.cos(latitude_rad)  # that zoom 0 shows in a tile's width
    zoom = math.log2(metres_m * _MAP_SHARE / max(city.size_m[:2]))
    return rrb.MapView(
        origin="earth",
        name="Map",
        zoom=min(_CLOSEST_ZOOM, zoom),
        background=rrb.MapProvider.OpenStreetMap,
        overrides={"earth/path": [VisibleTimeRanges([_WHOLE])]},
    )


def chase_view(city: MapRecord) -> rrb.Spatial3DView:
    """Fly behind the vehicle, looking along its course."""
    scale_m = 0.01 * max(city.size_m[:2])
    return _scene(
        "Chase",
        rrb.EyeControls3D(
            position=(-17.0 * scale_m, 0.0, 6.0 * scale_m),
            look_target=(8.0 * scale_m, 0.0, -1.0 * scale_m),
            eye_up=_UP,
        ),
        frame="world/chase",
        hidden=("world/vehicle/dot", "world/map/north", "world/pole/**", "world/marks/**"),
    )


def _scene(
    name: str,
    eye: rrb.EyeControls3D,
    *,
    frame: str | None = None,
    hidden: tuple[str, ...] = (),
) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin="world",
        contents=["+ $origin/**", *(f"- /{path}" for path in hidden)],
        name=name,
        background=rrb.Background(kind=rrb.BackgroundKind.SolidColor, color=colors.BACKGROUND),
        line_grid=rrb.LineGrid3D(visible=False),
        spatial_information=rrb.SpatialInformation(target_frame=f"tf#/{frame or 'world'}"),
        eye_controls=eye,
        overrides={
            f"world/path/{who}": [
                VisibleTimeRanges([_WHOLE]),
                rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(width)),
            ]
            for who, width in _PATH_WIDTHS.items()
        },
    )


def page(
    name: str, shown: Sequence[Curve], start: SessionStart, window: rrb.TimeRange
) -> rrb.Vertical:
    """Return plots above each other, as one tab."""
    return rrb.Vertical(*(plot(curve, start, window) for curve in shown), name=name)


def plot(curve: Curve, start: SessionStart, window: rrb.TimeRange) -> rrb.TimeSeriesView:
    """Return the plot of one curve."""
    return series(
        curve.path,
        curve.title,
        window,
        axis_y=rrb.ScalarAxis(range=curve.span(start)) if curve.span else None,
        corner=rrb.Corner2D.LeftTop if curve.legend_left else rrb.Corner2D.RightTop,
    )


def series(
    origin: str,
    title: str,
    window: rrb.TimeRange,
    *,
    contents: Sequence[str] = ("$origin/**",),
    axis_y: rrb.ScalarAxis | None = None,
    corner: rrb.Corner2D = rrb.Corner2D.RightTop,
    legend: bool = True,
) -> rrb.TimeSeriesView:
    """Return the plot of everything under ``origin``, or of a part of it."""
    return rrb.TimeSeriesView(
        origin=origin,
        contents=list(contents),
        name=title,
        axis_x=rrb.archetypes.TimeAxis(view_range=window),
        axis_y=axis_y,
        plot_legend=rrb.PlotLegend(corner=corner, visible=legend),
    )


def rates(window: rrb.TimeRange) -> rrb.TimeSeriesView:
    """Return the plot of message rates: of those that a flight rests on."""
    shown = [f"+ /{curves.RATES_PATH}/{name}" for name in curves.CHARTED]
    return series(curves.RATES_PATH, curves.RATES_TITLE, window, contents=shown)


def assemble(
    scenes: Sequence[rrb.View],
    plots: Sequence[rrb.Container],
    window: rrb.TimeRange,
    *,
    active: str,
    live: bool,
) -> rrb.Blueprint:
    """Return the whole layout: what to look at first is large, or at the left."""
    texts = [
        rrb.TextDocumentView(origin="summary", name="Summary"),
        rrb.StateTimelineView(
            origin="state", name="States", time_view=rrb.archetypes.TimeAxis(view_range=window)
        ),
        rrb.TextLogView(
            origin="log",
            name="Messages",
            columns=rrb.TextLogColumns(
                timeline_columns=["session"], text_log_columns=["LogLevel", "Body"]
            ),
        ),
    ]
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Tabs(*scenes, active_tab=active),
                rrb.Tabs(*plots, active_tab=0),
                column_shares=[3, 2],
            ),
            rrb.Horizontal(*texts, column_shares=[8, 6, 8]),
            row_shares=[13, 7],
        ),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(
            state="collapsed", timeline="session", play_state="following" if live else "paused"
        ),
        auto_views=False,
        auto_layout=False,
    )
