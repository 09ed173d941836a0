"""The words of ``companion mock --help``."""

from sim.mock.conduct import COMPLAINTS
from sim.mock.fault_kinds import KINDS

DESCRIPTION = """\
A MAVLink autopilot that is not there: it boots, arms, flies, refuses and fails
as PX4 1.18 or ArduCopter 4.6.3 does, on UDP or TCP, without a simulator.
Rates, answers, texts and delays are those measured on their simulators; what a
real autopilot refuses is refused here. It referees the companion that flies it.
"""

_MANUAL = """\
FIRST STEPS
  companion mock --connect udpout:127.0.0.1:14540
  is a PX4 at its simulator's home, calling the port on which companions listen.
  It is ready to arm 1.5 s later and ends with Ctrl-C.

PERSONALITIES  --autopilot
  px4        Streams by itself, as on its onboard port. Wants a setpoint stream
             before OFFBOARD and before arming there; a stream lost for 1 s is a
             failsafe; when the stream comes back it flies on by itself.
  ardupilot  Sends HEARTBEAT alone until asked (REQUEST_DATA_STREAM or
             SET_MESSAGE_INTERVAL). GUIDED, arm, NAV_TAKEOFF, and no stream
             before the climb is over; a stream lost for 3 s brakes it, and
             nothing says so.

PORTS  --connect, once for each link
  udpout:HOST:PORT   calls, as PX4's simulator does: the other side listens
  udpin:HOST:PORT    listens, and answers everyone who calls; udp: is the same
  tcpin:HOST:PORT    waits for one client
  tcp:HOST:PORT      calls one
  Usual ports: 14540 companion, 14550 ground station, 5760 ArduPilot over TCP.
  px4: a link on port 14550 has the rates of its ground-station port, any other
  those of the onboard port, about 430 messages a second; STATUSTEXT goes only
  to links on which a HEARTBEAT of type GCS was heard.
  ardupilot: all links are alike, and all get texts.
  HEARTBEATs and messages for others are passed on between the links.

IDENTITY
  System 1 (--sysid), component 1. Requests to other systems meet silence, those
  to other components silence (px4) or an answer (ardupilot), unknown commands
  UNSUPPORTED. Two vehicles are two processes with two ids; both may call one
  port.
  --signing-key signs everything with MAVLink 2 signing and drops what comes
  unsigned, wrongly signed, replayed or over a minute old. The file holds 32 raw
  bytes, 64 hexadecimal digits or a passphrase. SETUP_SIGNING works too. On its
  USB port (--usb-link) ArduPilot takes everything, whatever its signature.

TARGETS  --target kind=waypoints,sysid=42,...
  kind       static, straight, circle, waypoints (random) or recorded
  at=E:N:U   where it is or begins; drawn at random if not given
  to=E:N:U   straight: where it turns back       radius=10  circle, metres
  file=FILE  recorded: a CSV of time_s,east_m,north_m,up_m, or a .tlog
  speed=2    m/s                                 sysid=42
  message    gpi: GLOBAL_POSITION_INT at 5 Hz; follow: FOLLOW_TARGET at 4 Hz
  rate=HZ    reports a second                    autopilot=none or px4
  repeat=N   each report is sent N times, as by a telephone whose own position
             is slower                           drop=0  percent never sent
  Positions are map metres; without a map, metres east, north and up of the
  launch. Paths stay 2 m clear of obstacles.

FAULTS  --fault kind=KIND,t=SECONDS[,from=EVENT][,for=SECONDS][,KEY=VALUE...]
  t seconds after the event: start, arm, or offboard (setpoints fly it); for
  seconds later it is over. In brackets the keys that a kind knows; a number in
  its description is what it does without them. --seed repeats everything.
{kinds}

SPEED  --speed X
  The vehicle, its rates and its time stamps run X times as fast; whoever is
  connected does not: to a companion on the wall clock it flies X times as fast
  and answers X times as soon, which no vehicle does. For missions of this
  companion in less time, with its clock as fast as the vehicle's:
    companion run --connect mock:px4 --mock-speed X ...

REFEREE
  Watches the vehicle and whoever flies it. A complaint is logged when it begins
  and makes the exit code 1:
{complaints}
  and every contact with an obstacle of --map, which is also sent as STATUSTEXT
  and NAMED_VALUE_INT "contacts".
  --report FILE gets the whole verdict as JSON: passed, complaints, contacts
  (time, place, speed), min_clearance_m, left_map, distance_flown_m,
  max_speed_mps, setpoints_received, setpoints_outside_offboard,
  setpoints_refused, setpoints_by_sender, setpoints_after_mode_shown (sent
  although a HEARTBEAT had shown that OFFBOARD or GUIDED is over), timeline of
  modes, packets_refused (by signing).

EXAMPLES
  This companion, in a city, and what it did:
    companion mock --connect udpout:127.0.0.1:14540 --map env1 --report r.json
    companion run --connect udpin:127.0.0.1:14540 --map env1 ...
  MAVSDK (add_any_connection("udpin://0.0.0.0:14540")):
    companion mock --connect udpout:127.0.0.1:14540
  MAVProxy:
    companion mock --autopilot ardupilot --connect udpout:127.0.0.1:14550
    mavproxy.py --master=udpin:127.0.0.1:14550
  QGroundControl (listens on 14550 by itself), ArduPilot over TCP:
    companion mock --connect udpout:127.0.0.1:14550
    companion mock --autopilot ardupilot --connect tcpin:127.0.0.1:5760
  A companion and a ground station at once:
    companion mock --connect udpout:127.0.0.1:14540 \\
                   --connect udpout:127.0.0.1:14550
  A pilot who takes over 5 s after OFFBOARD, on a bad radio:
    companion mock --connect udpout:127.0.0.1:14540 \\
      --fault kind=rc_takeover,from=offboard,t=5 --fault kind=loss,percent=10
  Somebody to follow, by telephone, with gaps:
    companion mock --connect udpout:127.0.0.1:14540 \\
      --target kind=circle,message=follow,repeat=4,drop=20
  A second vehicle beside the first:
    companion mock --sysid 2 --connect udpout:127.0.0.1:14540 \\
      --home 47.3980,8.5456,489.4

EXIT CODES
  0 ended by SIGINT, SIGTERM or with its parent   1 the same, with complaints
  2 usage   3 link cannot open   5 map refused
"""


def epilog() -> str:
    """Return the manual below the options."""
    return _MANUAL.format(
        kinds="\n".join(
            f"  {name:<17} {kind.meaning}" + (f"\n{'':<20}[{', '.join(kind.keys)}]")
            if kind.keys and len(kind.meaning) + len(", ".join(kind.keys)) > 52
            else f"  {name:<17} {kind.meaning}" + (f" [{', '.join(kind.keys)}]" * bool(kind.keys))
            for name, kind in KINDS.items()
        ),
        complaints="\n".join(f"  - {meaning}" for meaning in COMPLAINTS.values()),
    )
