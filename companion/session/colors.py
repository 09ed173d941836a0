"""One colour for one meaning, in the scene, the plots and the bands alike."""

Color = tuple[int, int, int]

MEASURED: Color = (86, 190, 245)
"""What the vehicle did."""
PROPOSED: Color = (255, 190, 60)
"""What the policy asked for."""
SENT: Color = (110, 220, 130)
"""What the shield let through."""
TARGET: Color = (255, 92, 138)
DANGER: Color = (255, 66, 66)
"""Inside the margin."""
SHIELDED: Color = (255, 140, 40)
"""The shield changed the velocity."""
LIMIT: Color = (150, 154, 168)
"""Margins, limits and radii."""
IDLE: Color = (120, 124, 138)
"""Nobody flies, or somebody else."""
EXTRA: Color = (190, 130, 250)
"""A further curve in the same plot."""
BODY: Color = (235, 238, 244)
"""The vehicle itself."""
GROUND: Color = (46, 51, 63)
GRID: Color = (60, 66, 80)
BACKGROUND: Color = (17, 19, 25)
OUTLINE: Color = (14, 16, 20)
FENCE: Color = (66, 72, 88)

_GOOD: Color = (52, 132, 92)
_CALM: Color = (54, 104, 150)
_BUSY: Color = (40, 132, 138)
_LEAVING: Color = (122, 88, 170)
_CARE: Color = (176, 122, 30)
_ALARM: Color = (196, 84, 40)
_BAD: Color = (186, 48, 56)
_PILOT: Color = (168, 84, 140)
_QUIET: Color = (62, 68, 82)
_BANDS = (_CALM, _BUSY, _LEAVING, _CARE, _GOOD, _ALARM)
_BAND_WORDS: dict[Color, tuple[str, ...]] = {
    _GOOD: (
        *("engaged", "OFFBOARD", "GUIDED", "fresh"),
        *("fix", "ok", "heard", "in the air", "setpoints", "inside"),
    ),
    _CALM: ("ready", "armed", "AUTO.MISSION", "AUTO"),
    _BUSY: ("arming", "taking off", "engaging", "AUTO.TAKEOFF", "TAKEOFF"),
    _LEAVING: ("handing over", "landing", "AUTO.LAND", "AUTO.RTL", "LAND", "RTL", "SMART_RTL"),
    _CARE: ("holding", "AUTO.LOITER", "LOITER", "BRAKE", "coast", "speed limit", "ground"),
    _ALARM: ("obstacle", "blocked", "edge of the map", "hold", "glitch"),
    _BAD: (
        *("stood down", "inside the margin", "emergency", "lost"),
        *("no fix", "no position", "silent", "outside", "CRITICAL", "EMERGENCY", "TERMINATION"),
    ),
    _QUIET: ("-", "preflight", "done", "disarmed", "clear", "none", "on ground"),
    _PILOT: (
        *("POSCTL", "ALTCTL", "MANUAL", "ACRO", "STABILIZED"),
        *("STABILIZE", "ALT_HOLD", "POSHOLD", "SPORT", "DRIFT"),
    ),
}
_STEPS: tuple[Color, ...] = (
    *((255, 140, 40), (255, 190, 60), (220, 214, 90)),
    *((140, 220, 130), (90, 210, 190), (86, 190, 245)),
)
_BY_WORD = {word: color for color, words in _BAND_WORDS.items() for word in words}
_CYCLE: tuple[Color, ...] = (MEASURED, PROPOSED, SENT, TARGET, EXTRA, LIMIT, SHIELDED, FENCE)


def cycle(index: int) -> Color:
    """Return the colour of the ``index``-th line where colours mean nothing."""
    return _CYCLE[index % len(_CYCLE)]


def packed(color: Color) -> int:
    """Return a colour as one number, RGBA from the highest byte, opaque."""
    red, green, blue = color
    return red << 24 | green << 16 | blue << 8 | 0xFF


def scale(share: float) -> Color:
    """Return red for a share of 0 and less, through yellow, to blue for 1 and more, in steps."""
    if not share > 0.0:
        return DANGER
    return _STEPS[min(len(_STEPS) - 1, int(min(1.0, share) * len(_STEPS)))]


def bright(color: Color) -> Color:
    """Return a colour of the bands as a line on the dark scene wants it."""
    red, green, blue = (min(255, 60 + round(1.35 * part)) for part in color)
    return red, green, blue


def band_color(word: str, index: int) -> Color:
    """Return the colour of a state: its own if it is known here, else the ``index``-th."""
    return _BY_WORD.get(word, _BANDS[index % len(_BANDS)])
