"""Every error that a user can meet, each with the exit code it ends the program with.

    CompanionError                 8  internal, unless a subclass says otherwise
    |-- UsageError                 2  an option has a value that makes no sense
    |-- LinkOpenError              3  the socket or serial port cannot be opened
    |-- LinkLostError              4  nobody on the link, or nobody any more
    |-- RefusedError               5  refused before anything moved
    |   |-- MapError                  a map file is wrong, or a point lies outside the map
    |   |-- ActorError                an actor file is wrong or does not fit
    |   '-- AmbiguousVehicleError     more than one autopilot and none chosen
    '-- CommandError               6  the vehicle rejected a command or did not answer

Messages are one line: what is wrong, what was found, what to do.
"""

from typing import ClassVar


class CompanionError(Exception):
    """Base of all errors that end a command with one line on stderr and no traceback."""

    exit_code: ClassVar[int] = 8


class UsageError(CompanionError):
    """An option or an argument makes no sense."""

    exit_code = 2


class LinkOpenError(CompanionError):
    """The link cannot be opened: address in use, no such device, connection refused."""

    exit_code = 3


class LinkLostError(CompanionError):
    """Nobody is heard on the link."""

    exit_code = 4


class RefusedError(CompanionError):
    """Refused before anything moved: preflight, ambiguity, map, contract."""

    exit_code = 5


class MapError(RefusedError):
    """A map file cannot be used; the message names the file and the field."""


class ActorError(RefusedError):
    """An actor file cannot be used; the message names the file and the reason."""


class AmbiguousVehicleError(RefusedError):
    """More than one autopilot is heard and none was chosen."""


class CommandError(CompanionError):
    """The vehicle rejected a command or did not answer it."""

    exit_code = 6
