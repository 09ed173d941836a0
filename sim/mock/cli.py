"""The command line of the mock vehicle."""

import argparse
import sys
from collections.abc import Sequence

import numpy as np

from companion.errors import CompanionError, UsageError
from companion.world.frames import GeoPoint
from sim.mock.process import StopSignal, run
from sim.mock.sockets import open_link, parse_url
from sim.mock.vehicle import MockVehicle, Settings

PX4_SITL_HOME = GeoPoint(47.397742, 8.545594, 489.4)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the mock vehicle and return the exit code."""
    options = _parser().parse_args(arguments)
    try:
        return _fly(options)
    except CompanionError as error:
        print(f"mock: {error}", file=sys.stderr)
        return error.exit_code


def _fly(options: argparse.Namespace) -> int:
    if options.autopilot != "px4":
        raise UsageError(f"--autopilot {options.autopilot}: only px4 exists so far")
    stop = StopSignal(with_parent=options.exit_with_parent)
    addresses = [parse_url(url) for url in options.connect]
    vehicle = MockVehicle(
        Settings(home=PX4_SITL_HOME, boot_s=options.boot_s),
        ground_links=[address.ground for address in addresses],
        rng=np.random.default_rng(options.seed),
    )
    links = [open_link(address) for address in addresses]
    for url in options.connect:
        print(f"mock: px4 on {url}", flush=True)
    try:
        run(vehicle, links, speed=options.speed, stop=stop)
    finally:
        for link in links:
            link.close()
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="companion mock")
    parser.add_argument("--autopilot", default="px4")
    parser.add_argument("--connect", action="append", required=True)
    parser.add_argument("--map")
    parser.add_argument("--target", action="append", default=[])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--boot-s", type=float, default=1.5)
    parser.add_argument("--exit-with-parent", action="store_true")
    return parser
