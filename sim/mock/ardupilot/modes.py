"""ArduCopter's flight modes: numbers, names and what each asks for (A16)."""

from enum import Enum

MODE_MANUAL_INPUT = 0x40
MODE_STABILIZE = 0x10
MODE_GUIDED = 0x08
MODE_CUSTOM = 0x01
ARMED = 0x80


class Mode(Enum):
    """A mode by its number in HEARTBEAT.custom_mode."""

    STABILIZE = 0
    ALT_HOLD = 2
    AUTO = 3
    GUIDED = 4
    LOITER = 5
    RTL = 6
    LAND = 9
    POSHOLD = 16
    BRAKE = 17

    @property
    def is_external(self) -> bool:
        """Whether the vehicle obeys setpoints in it."""
        return self is Mode.GUIDED

    @property
    def requires_position(self) -> bool:
        """Whether it is refused in flight without a position."""
        return self not in (Mode.STABILIZE, Mode.ALT_HOLD, Mode.LAND)

    @property
    def allows_arming(self) -> bool:
        """Whether a ground station may arm in it (A12)."""
        return self in (Mode.STABILIZE, Mode.ALT_HOLD, Mode.GUIDED, Mode.LOITER, Mode.POSHOLD)

    @property
    def block_bit(self) -> int:
        """The bit of FLTMODE_GCSBLOCK that forbids it to ground stations; 0 where none does."""
        return _BLOCK_BITS.get(self, 0)


_BLOCK_BITS = {
    Mode.STABILIZE: 1 << 0,
    Mode.ALT_HOLD: 1 << 2,
    Mode.AUTO: 1 << 3,
    Mode.GUIDED: 1 << 4,
    Mode.LOITER: 1 << 5,
    Mode.POSHOLD: 1 << 11,
    Mode.BRAKE: 1 << 12,
}
NUMBERS = frozenset({*range(8), 9, 11, *range(13, 29)})
"""The modes that ArduCopter 4.6 knows, most of which are not imitated."""


def find_mode(number: int) -> Mode | None:
    """Return the mode with this number, if it is imitated."""
    return next((mode for mode in Mode if mode.value == number), None)
