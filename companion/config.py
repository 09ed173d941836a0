"""What ``companion run`` and ``preflight`` can be told: dataclass, command line and YAML file.

The command line wins over the file given by ``--config``, which wins over the defaults here.
"""

import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
import tyro
import yaml

from companion.arrays import FloatArray
from companion.errors import UsageError
from companion.mock_process import MOCK_PREFIX, MOCK_SYSID, MOCKS
from companion.world.frames import GeoPoint
from companion.yaml_keys import EachKeyOnce

DEFAULT_ACTOR = "flight"
V_MAX_LOW_MPS = 0.1


@dataclass(frozen=True)
class SiteConfig:
    """Where the vehicle is, on which map, and where it shall go: what preflight can look at."""

    connect: str = ""
    """Where the vehicle is: udp:HOST:PORT (listen), udpout:HOST:PORT, tcp:HOST:PORT,
    serial:DEVICE:BAUD, or mock:px4 or mock:ardupilot to start the built-in mock
    vehicle."""
    map: str = "free"
    """Map file, or the name of a bundled map."""
    vehicle_sysid: int | None = None
    """System id of the vehicle; needed where more than one autopilot is heard."""
    target: str | None = None
    """Static target E,N,U in metres of the map."""
    target_global: str | None = None
    """Static target LAT,LON,ALT: degrees, degrees, metres above mean sea level."""
    target_sysid: int | None = None
    """Pursue this system: its GLOBAL_POSITION_INT or FOLLOW_TARGET."""
    v_max: float = 5.0
    """Speed cap (m/s)."""
    margin: float = 2.0
    """Clearance that the shield keeps from obstacles and from the edges of the map (m)."""
    takeoff: float | None = None
    """Take off to this height above the ground (m)."""
    backend: Literal["pymavlink", "mavsdk"] = "pymavlink"
    """The library that reads and writes MAVLink; the contract is the same."""
    signing_key: Path | None = None
    """File of a MAVLink 2 signing key: 32 raw bytes, 64 hexadecimal digits, or a passphrase.
    What is not signed with it is ignored, targets and ground stations included."""

    def check(self) -> None:
        """Refuse values that make no sense.

        Raises:
            UsageError: Names the option, what was found and what is allowed.
        """
        if not self.connect:
            raise UsageError("--connect is missing, for example --connect udp:0.0.0.0:14540")
        if self.connect.startswith(MOCK_PREFIX) and self.connect not in MOCKS:
            raise UsageError(f"--connect {self.connect}: there is {' and '.join(MOCKS)}")
        _check_range("--v-max", self.v_max, V_MAX_LOW_MPS, 20.0, "m/s")
        _check_range("--margin", self.margin, 0.5, 20.0, "m")
        if self.takeoff is not None:
            _check_range("--takeoff", self.takeoff, 2.0, 500.0, "m")
        given = [
            name
            for name in ("target", "target_global", "target_sysid")
            if getattr(self, name) is not None
        ]
        if len(given) > 1:
            options = " and ".join("--" + name.replace("_", "-") for name in given)
            raise UsageError(f"{options} exclude each other: give one target")
        for name in ("vehicle_sysid", "target_sysid"):
            value = getattr(self, name)
            if value is not None and not 1 <= value <= 255:
                raise UsageError(f"--{name.replace('_', '-')} must be 1 to 255, got {value}")
        if self.target_sysid is not None and self.target_sysid == self.vehicle_sysid:
            raise UsageError(f"--target-sysid {self.target_sysid} is the vehicle itself")
        if self.target_sysid == MOCK_SYSID and self.connect in MOCKS:
            raise UsageError(f"--target-sysid {self.target_sysid} is the mock vehicle; try 42")
        self.target_enu_m()
        self.target_geodetic()

    def target_enu_m(self) -> FloatArray | None:
        """Return the static map target, shape ``(3,)``, or ``None``."""
        if self.target is None:
            return None
        return np.array(_three_numbers("--target", self.target, "E,N,U in map metres"))

    def target_geodetic(self) -> GeoPoint | None:
        """Return the static geodetic target, or ``None``."""
        if self.target_global is None:
            return None
        latitude, longitude, altitude_m = _three_numbers(
            "--target-global", self.target_global, "LAT,LON,ALT"
        )
        if not (-90 <= latitude <= 90 and -180 <= longitude <= 180):
            raise UsageError(f"--target-global {self.target_global}: no such latitude or longitude")
        return GeoPoint(latitude, longitude, altitude_m)


@dataclass(frozen=True)
class PreflightConfig(SiteConfig):
    """Look at a vehicle before a flight and say GO or NO-GO, with the reasons.

    Listens for a few seconds and reads parameters. Sends nothing but heartbeats, answers to the
    autopilot's TIMESYNC, and requests for data (messages, their rates, parameters): nothing that
    moves or changes the vehicle, and no parameter is written. Exit code 0 is GO, 5 is NO-GO.
    """

    takeoff: float | None = None
    """Check a take-off to this height above the ground, too (m)."""
    json: Annotated[bool, tyro.conf.arg(help="One object on stdout instead of the table.")] = False


@dataclass(frozen=True)
class RunConfig(SiteConfig):
    """Fly a policy on one vehicle.

    By default nothing moves until the pilot arms, takes off and selects OFFBOARD or GUIDED.
    """

    actor: str = DEFAULT_ACTOR
    """Actor file (.onnx), or the name of a bundled actor."""
    rate_hz: float = 20.0
    """Control rate (Hz)."""
    engage: bool = False
    """Ask for OFFBOARD / GUIDED instead of waiting for the pilot to select it."""
    arm: bool = False
    """Arm the vehicle; needs --takeoff."""
    on_exit: Literal["hold", "land", "rtl", "none"] = "hold"
    """What to ask of the vehicle at the end; none just stops the stream."""
    cap_by_failsafe: bool = False
    """Lower --v-max until the vehicle, should this program die, stops within --margin. The
    vehicle's own failsafe parameters say how far it flies blind; they are read, never written."""
    shadow: bool = False
    """Decide and record, send no setpoint and no command."""
    record: Path = Path("sessions")
    """Folder in which the session's own folder is made."""
    mock_speed: float = 1.0
    """With mock:px4 or mock:ardupilot: seconds of the flight in a second of ours, for whole
    missions in less time. Late ticks tell that the computer cannot keep up."""
    rerun: Literal["off", "serve", "spawn"] = "off"
    """Live view: serve it on loopback, or also open a viewer."""
    config: Path | None = None
    """YAML file with these same options."""
    json: Annotated[bool, tyro.conf.arg(help="One summary object on stdout.")] = False

    def check(self) -> None:
        """Refuse values that make no sense.

        Raises:
            UsageError: Names the option, what was found and what is allowed.
        """
        super().check()
        _check_range("--rate-hz", self.rate_hz, 5.0, 100.0, "Hz")
        _check_range("--mock-speed", self.mock_speed, 0.1, 10.0, "seconds a second")
        if self.mock_speed != 1.0 and self.connect not in MOCKS:
            raise UsageError(
                f"--mock-speed is for --connect {' or '.join(MOCKS)}: "
                "a vehicle elsewhere lives as fast as the wall clock"
            )
        if self.arm and self.takeoff is None:
            raise UsageError("--arm needs --takeoff ALT, or the vehicle stays on the ground")
        if self.shadow and (self.arm or self.engage or self.takeoff is not None):
            raise UsageError("--shadow sends nothing: leave out --arm, --takeoff and --engage")

    def as_dict(self) -> dict[str, Any]:
        """Return the effective configuration as plain data, for the session folder."""
        return {
            key: str(value) if isinstance(value, Path) else value
            for key, value in asdict(self).items()
        }


def load_run_config(path: Path) -> RunConfig:
    """Read the options of ``companion run`` from a YAML file; keys as on the command line.

    Raises:
        UsageError: If the file cannot be read or a key or value is wrong; names both.
    """
    try:
        data = yaml.load(path.read_text(encoding="utf-8"), _OptionLoader)
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"cannot read --config {path}: {error}") from error
    except RecursionError as error:
        raise UsageError(f"--config {path} is nested too deeply") from error
    except yaml.YAMLError as error:
        raise UsageError(f"--config {path} is not YAML: {_one_line(error)}") from error
    if not isinstance(data, dict):
        raise UsageError(f"--config {path} must hold options such as 'map: env1'")
    known = {f.name for f in fields(RunConfig)} - {"config"}
    values: dict[str, Any] = {}
    for key, value in data.items():
        name = str(key).replace("-", "_")
        if name not in known:
            raise UsageError(f"--config {path}: no such option {key!r}")
        values[name] = (
            ",".join(map(str, value))
            if name in ("target", "target_global") and isinstance(value, list)
            else value
        )
    try:
        return msgspec.convert(values, RunConfig, dec_hook=_path_hook)
    except msgspec.ValidationError as error:
        raise UsageError(f"--config {path}: {error}") from error


class _OptionLoader(EachKeyOnce, yaml.SafeLoader):
    """``v-max`` and ``v_max`` are one option."""

    @staticmethod
    def spelled(key: str) -> str:
        return key.replace("-", "_")


def restore_run_config(values: dict[str, Any]) -> RunConfig:
    """Return the options that ``RunConfig.as_dict`` has written.

    Raises:
        UsageError: If they are not those of this version.
    """
    try:
        return msgspec.convert(values, RunConfig, dec_hook=_path_hook)
    except msgspec.ValidationError as error:
        raise UsageError(f"the session's options are not those of this version: {error}") from error


def _path_hook(kind: type, value: Any) -> Any:
    if kind is Path:
        return Path(value)
    raise NotImplementedError(kind)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _check_range(option: str, value: float, low: float, high: float, unit: str) -> None:
    if not (math.isfinite(value) and low <= value <= high):
        raise UsageError(f"{option} must be {low:g} to {high:g} {unit}, got {value:g}")


def _three_numbers(option: str, text: str, form: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise UsageError(f"{option} must be {form}, for example 80,80,20; got {text!r}")
    return numbers
