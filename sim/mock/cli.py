"""The command line of the mock vehicle."""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import numpy as np

from companion.errors import CompanionError, UsageError
from companion.world.frames import GeoPoint
from sim.mock.ardupilot.personality import ARDUPILOT
from sim.mock.fault_kinds import KINDS
from sim.mock.faults import parse_fault
from sim.mock.personality import Personality
from sim.mock.placement import Place, place_vehicle
from sim.mock.process import StopSignal, run
from sim.mock.px4.personality import PX4
from sim.mock.sockets import Address, Link, open_link, parse_url
from sim.mock.targets import parse_target
from sim.mock.vehicle import MockVehicle, Settings

DESCRIPTION = """\
A MAVLink autopilot that is not there: it boots, arms, flies, refuses and fails as PX4 1.18 or
ArduCopter 4.6.3 does, on UDP or TCP, without a simulator. Rates, answers, texts and delays are
those measured on their simulators; what a real autopilot refuses is refused here.
"""

EPILOG = """\
personalities  --autopilot
  px4        streams by itself; wants a setpoint stream before OFFBOARD and before arming there;
             a stream lost for 1 s is a failsafe
  ardupilot  sends HEARTBEAT alone until asked (REQUEST_DATA_STREAM, SET_MESSAGE_INTERVAL);
             GUIDED, arm, NAV_TAKEOFF, and no stream before the climb is over; a stream lost for
             3 s brakes it, and nothing says so

links
  udpout:HOST:PORT  calls, as PX4 SITL does: the other side listens
  udpin:HOST:PORT   listens, and answers everyone who calls (udp: means the same)
  tcpin:HOST:PORT   waits for one client;  tcp:HOST:PORT calls one
  px4: a link on port 14550 has the rates of its ground-station port, any other those of the
  onboard port (about 430 messages a second), and STATUSTEXT goes only to links on which a
  HEARTBEAT of type GCS was heard. ardupilot: all links are alike, and all get texts.
  Heartbeats and messages for others are passed on.

identity
  system 1, component 1. Requests to other systems meet silence, those to other components
  silence (px4) or an answer (ardupilot); unknown commands UNSUPPORTED.

targets  --target kind=waypoints,sysid=42,...
  kind=static|straight|circle|waypoints   message=gpi|follow (GLOBAL_POSITION_INT, FOLLOW_TARGET)
  sysid=42  rate=5 (Hz)  speed=2 (m/s)  at=E:N:U  to=E:N:U (straight)  radius=10 (circle)
  autopilot=none|px4 (px4: looks like a second vehicle). Positions are map metres; without a
  map, metres east, north and up of the launch. Without at= a free place is drawn. Paths stay
  2 m clear of obstacles.

faults  --fault t=SECONDS,kind=KIND[,from=start|arm|offboard][,for=SECONDS][,key=value...]
  offboard is when setpoints begin to fly it: in OFFBOARD, or in GUIDED after the take-off.
{kinds}

report  --report FILE, written at the end as JSON
  contacts (time, place, speed), min_clearance_m, left_map, distance_flown_m, max_speed_mps,
  setpoints_received, setpoints_outside_offboard, setpoints_refused, setpoints_by_sender,
  setpoints_after_mode_shown (sent although a HEARTBEAT had shown that OFFBOARD or GUIDED is
  over: 0 or 1 for a good companion), timeline of modes. A contact is also logged here and sent
  as STATUSTEXT and NAMED_VALUE_INT "contacts".

examples
  The companion:      companion mock --connect udpout:127.0.0.1:14540 --map env1
                      companion run --connect udpin:127.0.0.1:14540 --map env1 ...
  MAVSDK:             companion mock --connect udpout:127.0.0.1:14540
                      then connect MAVSDK to udpin://0.0.0.0:14540
  MAVProxy:           companion mock --autopilot ardupilot --connect udpout:127.0.0.1:14550
                      mavproxy.py --master=udpin:127.0.0.1:14550
  QGroundControl:     companion mock --connect udpout:127.0.0.1:14550
  Both at once:       --connect udpout:127.0.0.1:14540 --connect udpout:127.0.0.1:14550
  A pilot who takes over 5 s after OFFBOARD, on a bad radio:
                      --fault from=offboard,t=5,kind=rc_takeover --fault kind=loss,percent=10

exit codes
  0 ended by SIGINT, SIGTERM or with its parent; 2 usage; 3 link cannot open; 5 map refused
"""


PERSONALITIES = {personality.name: personality for personality in (PX4, ARDUPILOT)}
_RANGES = {
    "speed": (0.01, 100.0),
    "boot_s": (0.1, 600.0),
    "shortfall": (0.0, 0.9),
    "gusts": (0.0, 50.0),
    "noise": (0.0, 100.0),
    "seed": (0, 2**63),
}


class _Parser(argparse.ArgumentParser):
    """A parser whose complaints are errors like all others: one line, exit code 2."""

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message}; see --help")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the mock vehicle and return the exit code."""
    try:
        return _fly(_parser().parse_args(arguments))
    except CompanionError as error:
        print(f"mock: {error}", file=sys.stderr)
        return error.exit_code


def _fly(options: argparse.Namespace) -> int:
    personality = PERSONALITIES.get(options.autopilot)
    if personality is None:
        known = ", ".join(PERSONALITIES)
        raise UsageError(f"--autopilot {options.autopilot}: not built; there is {known}")
    if options.report is not None:
        _write(options.report, "")  # a report that cannot be written is found out now
    stop = StopSignal(with_parent=options.exit_with_parent)
    addresses = [parse_url(url) for url in options.connect]
    vehicle = _build(options, personality, addresses)
    links: list[Link] = []
    try:
        for address, url in zip(addresses, options.connect, strict=True):
            links.append(open_link(address))
            rates = personality.rates_of(address.ground)
            print(f"mock: {personality.name}, system 1, on {url} ({rates})", flush=True)
        run(vehicle, links, speed=options.speed, stop=stop)
    finally:
        for link in links:
            link.close()
    if options.report is not None:
        report = {"autopilot": options.autopilot, "seed": options.seed, **vehicle.report()}
        _write(options.report, json.dumps(report, indent=2) + "\n")
    return 0


def _build(
    options: argparse.Namespace, personality: Personality, addresses: Sequence[Address]
) -> MockVehicle:
    _check_ranges(options)
    seeds = np.random.SeedSequence(options.seed).spawn(1 + len(options.target))
    place = _place(options, personality)
    vehicle_rng, *target_rngs = (np.random.default_rng(seed) for seed in seeds)
    north, east = _numbers("--wind", options.wind, 2)
    targets = [
        parse_target(text, place, rng)
        for text, rng in zip(options.target, target_rngs, strict=True)
    ]
    sysids = [target.sysid for target in targets]
    if len({1, *sysids}) != 1 + len(sysids):
        raise UsageError("--target: system ids must differ from each other and from 1")
    return MockVehicle(
        Settings(
            place=place,
            boot_s=options.boot_s,
            radio=options.radio,
            personality=personality,
            response=replace(personality.response, shortfall=options.shortfall),
            wind_ned_mps=(north, east, 0.0),
            gust_mps=options.gusts,
            noise_m=options.noise,
        ),
        ground_links=[address.ground for address in addresses],
        rng=vehicle_rng,
        targets=targets,
        faults=[
            parse_fault(text, links=len(addresses), targets=sysids, personality=personality)
            for text in options.fault
        ],
    )


def _check_ranges(options: argparse.Namespace) -> None:
    for name, (low, high) in _RANGES.items():
        if not low <= getattr(options, name) <= high:  # a NaN fails too
            raise UsageError(f"--{name.replace('_', '-')} must lie in {low:g}..{high:g}")


def _place(options: argparse.Namespace, personality: Personality) -> Place:
    home = None
    if options.home is not None:
        home = GeoPoint(*_numbers("--home", options.home, 3))
        if not (abs(home.latitude_deg) < 89.0 and abs(home.longitude_deg) <= 180.0):
            raise UsageError(f"--home {options.home}: not a place on earth")
    if options.map is None:
        return place_vehicle(None, home, personality)
    from companion.world.maps import load_map  # shapely only where a map is flown

    return place_vehicle(load_map(options.map), home, personality)


def _numbers(option: str, text: str, count: int) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise UsageError(f"{option} {text}: expected {count} numbers with commas between")
    return numbers


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text)
    except OSError as error:
        raise UsageError(f"cannot write --report {path}: {error.strerror}") from error


def _parser() -> argparse.ArgumentParser:
    kinds = "\n".join(
        f"  {name:<17} {kind.meaning}" + (f"  [{', '.join(kind.keys)}]" if kind.keys else "")
        for name, kind in KINDS.items()
    )
    parser = _Parser(
        prog="companion mock",
        description=DESCRIPTION,
        epilog=EPILOG.format(kinds=kinds),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("--autopilot", default="px4", metavar="NAME", help="personality: px4 or ardupilot (px4)")
    add(
        "--connect",
        action="append",
        required=True,
        metavar="URL",
        help="a link; may be given several times",
    )
    add("--map", metavar="FILE|NAME", help="map whose obstacles the referee watches")
    add(
        "--home",
        metavar="LAT,LON,ALT",
        help="where it boots, degrees and metres AMSL (that of its simulator; on a map with a "
        "place on earth, that of PX4's on the ground)",
    )
    add("--target", action="append", default=[], metavar="SPEC", help="another system; see below")
    add("--fault", action="append", default=[], metavar="SPEC", help="what goes wrong; see below")
    add("--radio", action="store_true", help="a pilot with a transmitter, sticks centred")
    add("--boot-s", type=float, default=1.5, metavar="S",
        help="from start to ready to arm (1.5; PX4 SITL takes 4.6, ArduPilot 41.6)")  # fmt: skip
    add("--shortfall", type=float, default=0.0, metavar="X",
        help="share of a horizontal velocity never reached (0; PX4 SIH 0.16)")  # fmt: skip
    add("--wind", default="0,0", metavar="N,E", help="wind velocity in m/s (0,0)")
    add("--gusts", type=float, default=0.0, metavar="MPS", help="deviation of gusts (0)")
    add("--noise", type=float, default=0.0, metavar="M", help="deviation of position noise (0)")
    add("--speed", type=float, default=1.0, metavar="X", help="simulated seconds per second (1)")
    add("--seed", type=int, default=0, help="seed of everything random (0)")
    add("--report", type=Path, metavar="FILE", help="write the referee's verdict here at the end")
    add("--exit-with-parent", action="store_true", help="end when the starting process dies")
    return parser
