"""The command line of the mock vehicle."""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NoReturn

import numpy as np

from companion import clock
from companion.errors import CompanionError, UsageError
from companion.world.frames import GeoPoint
from sim.mock.ardupilot.personality import ARDUPILOT
from sim.mock.faults import parse_fault
from sim.mock.manual import DESCRIPTION, epilog
from sim.mock.personality import Personality
from sim.mock.placement import Place, place_vehicle
from sim.mock.process import StopSignal, run
from sim.mock.px4.personality import PX4
from sim.mock.signing import load_key, stamp_at
from sim.mock.sockets import Address, Link, open_link, parse_url
from sim.mock.targets import parse_target
from sim.mock.vehicle import MockVehicle, Settings

PERSONALITIES = {personality.name: personality for personality in (PX4, ARDUPILOT)}
FAILED = 1
"""Exit code of a flight that the referee complains about."""
_RANGES = {
    "sysid": (1, 255),
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
            who = f"{personality.name}, system {options.sysid}"
            print(f"mock: {who}, on {url} ({rates})", flush=True)
        run(vehicle, links, speed=options.speed, stop=stop)
    finally:
        for link in links:
            link.close()
    report = {"autopilot": options.autopilot, "seed": options.seed, **vehicle.report()}
    if options.report is not None:
        _write(options.report, json.dumps(report, indent=2) + "\n")
    for complaint in report["complaints"]:
        print(f"mock: FAILED: {complaint}", file=sys.stderr)
    return 0 if report["passed"] else FAILED


def _build(
    options: argparse.Namespace, personality: Personality, addresses: Sequence[Address]
) -> MockVehicle:
    _check_ranges(options)
    if not 0 <= options.usb_link <= len(addresses):
        raise UsageError(f"--usb-link {options.usb_link}: there are only {len(addresses)} links")
    seeds = np.random.SeedSequence(options.seed).spawn(1 + len(options.target))
    place = _place(options, personality)
    vehicle_rng, *target_rngs = (np.random.default_rng(seed) for seed in seeds)
    north, east = _numbers("--wind", options.wind, 2)
    targets = [
        parse_target(text, place, rng)
        for text, rng in zip(options.target, target_rngs, strict=True)
    ]
    sysids = [target.sysid for target in targets]
    if len({options.sysid, *sysids}) != 1 + len(sysids):
        raise UsageError(
            f"--target: system ids must differ from each other and from {options.sysid}"
        )
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
            system_id=options.sysid,
            signing_key=None if options.signing_key is None else load_key(options.signing_key),
            signing_stamp=stamp_at(clock.utc_now()),
            usb_link=options.usb_link,
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
    parser = _Parser(
        prog="companion mock",
        description=DESCRIPTION,
        epilog=epilog(),
        formatter_class=partial(argparse.RawDescriptionHelpFormatter, width=80),
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("--autopilot", default="px4", metavar="NAME", help="px4 or ardupilot (px4)")
    add("--connect", action="append", required=True, metavar="URL", help="a link; see PORTS")
    add("--sysid", type=int, default=1, metavar="N", help="system id (1)")
    add("--signing-key", type=Path, metavar="FILE", help="sign, and refuse who does not")
    add("--usb-link", type=int, default=0, metavar="N",
        help="the Nth link is the USB port, where ArduPilot trusts everybody (none)")  # fmt: skip
    add("--map", metavar="FILE|NAME", help="map whose obstacles the referee watches")
    add(
        "--home",
        metavar="LAT,LON,ALT",
        help="where it boots, degrees and metres AMSL (that of its simulator; on a map with a "
        "place on earth, that of PX4's on the ground, or open ground near its middle)",
    )
    add("--target", action="append", default=[], metavar="SPEC", help="another system; see TARGETS")
    add("--fault", action="append", default=[], metavar="SPEC", help="what goes wrong; see FAULTS")
    add("--radio", action="store_true", help="a pilot with a transmitter, sticks centred")
    add("--boot-s", type=float, default=1.5, metavar="S",
        help="from start to ready to arm (1.5; PX4 SITL takes 4.6, ArduPilot 41.6)")  # fmt: skip
    add("--shortfall", type=float, default=0.0, metavar="X",
        help="share of a horizontal velocity never reached (0; PX4 SIH 0.16)")  # fmt: skip
    add("--wind", default="0,0", metavar="N,E", help="wind velocity in m/s (0,0)")
    add("--gusts", type=float, default=0.0, metavar="MPS", help="deviation of gusts (0)")
    add("--noise", type=float, default=0.0, metavar="M", help="deviation of position noise (0)")
    add("--speed", type=float, default=1.0, metavar="X",
        help="simulated seconds per second (1); see SPEED")  # fmt: skip
    add("--seed", type=int, default=0, metavar="N", help="seed of everything random (0)")
    add("--report", type=Path, metavar="FILE", help="write the referee's verdict here at the end")
    add("--exit-with-parent", action="store_true", help="end when the starting process dies")
    return parser
