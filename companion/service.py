"""``companion service``: prints a systemd unit that flies unattended, with a note to its operator.

The unit waits for the pilot: it may not arm, take off or engage by itself, because systemd would
start it again and again. A stand-down stays one: only an operator starts it anew.
"""

import getpass
import shlex
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from companion.config import RunConfig
from companion.errors import UsageError
from companion.guidance.situation import EXIT_CODES, Outcome

WATCHDOG_S = 5
"""A loop that is silent this long has long lost the vehicle to its own failsafe."""
STOP_S = 40
"""Handing over takes 4 s, an unanswered request 8, the recorder up to 20."""
RESTART_S = 5

_NEVER_AGAIN = (
    UsageError.exit_code,
    EXIT_CODES[Outcome.COMMAND_FAILED],
    EXIT_CODES[Outcome.STOOD_DOWN],
    EXIT_CODES[Outcome.FAILED],
)
_UNIT = """\
# Save as /etc/systemd/system/mavlink-companion.service, then:
#   systemctl daemon-reload && systemctl enable --now mavlink-companion
#   journalctl -fu mavlink-companion          what it says
#   systemctl stop mavlink-companion          gives the vehicle back (HOLD), then ends
#
# For its operator:
# - It waits until the pilot arms, takes off and selects OFFBOARD / GUIDED; then it flies.
# - Whoever changes the mode has the vehicle. The program ends (exit {stood_down}) and stays ended:
#   nothing flies again before somebody says: systemctl start mavlink-companion
# - It starts again by itself only where nothing was flown or the link was lost: no vehicle yet,
#   preflight refused, link or target lost. Then it waits for the pilot as at first.
# - A loop that hangs for {watchdog} s is killed; another starts and waits for the pilot. The
#   setpoints have stopped long before: the autopilot's own failsafe has the vehicle
#   (`companion preflight` says what it does).
# - A full or read-only disk does not stop a flight; the journal says that it is not recorded.
#   Every run leaves a folder of its own in --record; remove old ones, for example daily:
#     find {record} -mindepth 1 -maxdepth 1 -mtime +30 -exec rm -r {{}} +

[Unit]
Description=MAVLink companion: flies a learned policy when the pilot lets it
StartLimitIntervalSec=0

[Service]
Type=notify
ExecStart={command}
User={user}
WorkingDirectory={folder}
WatchdogSec={watchdog}
TimeoutStartSec=infinity
TimeoutStopSec={stop}
# The recorder ends by itself when its files are complete, whatever the flying process died of.
KillMode=control-group
# Stopped as asked, in flight as well.
SuccessExitStatus={stopped}
Restart=on-failure
RestartSec={restart}
RestartPreventExitStatus={never_again}
# The control loop before everything else that is not the kernel's.
Nice=-10
OOMScoreAdjust=-500
NoNewPrivileges=yes
ProtectSystem=full
PrivateTmp=yes

[Install]
WantedBy=multi-user.target
"""


def unit(config: RunConfig, argv: Sequence[str]) -> str:
    """Return a unit that runs ``companion run`` with these options.

    Args:
        config: The options, checked here.
        argv: The same as they were given.

    Raises:
        UsageError: If an option makes no sense, or would move the vehicle unasked.
    """
    config.check()
    if config.arm or config.engage or config.takeoff is not None:
        raise UsageError(
            "a service waits for the pilot: leave out --arm, --takeoff and --engage, for systemd "
            "would start it again after every flight"
        )
    program = shutil.which("companion") or str(Path(sys.executable).with_name("companion"))
    return _UNIT.format(
        command=" ".join(map(_quoted, (program, "run", *argv))),
        user=getpass.getuser(),
        folder=Path.cwd(),
        record=shlex.quote(str(config.record.absolute())),
        watchdog=WATCHDOG_S,
        stop=STOP_S,
        restart=RESTART_S,
        stopped=EXIT_CODES[Outcome.STOPPED],
        stood_down=EXIT_CODES[Outcome.STOOD_DOWN],
        never_again=" ".join(map(str, _NEVER_AGAIN)),
    )


def _quoted(word: str) -> str:
    """Return a word as systemd reads it back: %, $ and quotes mean something to it."""
    escaped = word.replace("\\", "\\\\").replace("%", "%%").replace("$", "$$")
    if not escaped or any(letter in escaped for letter in " \t\"';"):
        return '"' + escaped.replace('"', '\\"') + '"'
    return escaped
