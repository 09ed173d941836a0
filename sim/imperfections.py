"""What real vehicles and links are like: sluggish, short of what is asked, late, lossy, unsteady.

A world is perfect in these by default; ``RECORDED`` is what the recordings of PX4 and ArduCopter
show, ``POOR_RADIO`` the same vehicles far away.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from companion.arrays import FloatArray, IntArray
from sim.dynamics import Disturbance


@dataclass(frozen=True, slots=True)
class Imperfections:
    """By default none. Pairs are the least and the largest of a draw for each episode."""

    acceleration_max_mps2: tuple[float, float] | None = None
    """Limits of the acceleration, in place of the lag's."""
    shortfall: tuple[float, float] = (0.0, 0.0)
    """Share of a horizontal velocity that is never reached."""
    age_s: tuple[float, float] = (0.0, 0.0)
    """Age of the position and velocity that are known; read off a straight line between steps."""
    setpoint_loss: float = 0.0
    """Share of setpoints that never arrive: the vehicle follows the one before."""
    target_noise: Disturbance | None = None
    """Error of the target's position, in metres."""
    target_silence_s: tuple[float, float] | None = None
    """Mean time between two silences of the target, and how long each lasts."""

    def __post_init__(self) -> None:
        most_mps2, short, age_s = self.acceleration_max_mps2, self.shortfall, self.age_s
        if most_mps2 is not None and not 0.0 < most_mps2[0] <= most_mps2[1]:
            raise ValueError(f"acceleration_max_mps2 must be positive, ascend, got {most_mps2}")
        if not 0.0 <= short[0] <= short[1] < 1.0:
            raise ValueError(f"shortfall must ascend within [0, 1), got {short}")
        if not 0.0 <= age_s[0] <= age_s[1]:
            raise ValueError(f"age_s must ascend from 0, got {age_s}")
        if not 0.0 <= self.setpoint_loss < 1.0:
            raise ValueError(f"setpoint_loss must be in [0, 1), got {self.setpoint_loss}")
        if self.target_silence_s is not None and not min(self.target_silence_s) > 0.0:
            raise ValueError(f"target_silence_s must be positive, got {self.target_silence_s}")


RECORDED = Imperfections(acceleration_max_mps2=(1.6, 2.5), shortfall=(0.0, 0.16), age_s=(0.02, 0.2))
"""ArduCopter 4.6 accelerates by 1.6 m/s2, PX4 1.18 by 2.5 and falls 14 to 16 % short; positions
were 20 to 250 ms old, 100 ms as a rule."""

POOR_RADIO = replace(
    RECORDED,
    setpoint_loss=0.1,
    target_noise=Disturbance(std=0.5, correlation_s=2.0),
    target_silence_s=(10.0, 1.0),
)
"""Losses, noise and silences are beyond what was recorded."""


class Flown:
    """What ``N`` imperfect vehicles do and show; arrays are replaced, never written into.

    It draws from a generator of its own: the world's cases and gusts are those of perfect vehicles.
    """

    def __init__(
        self, options: Imperfections, num_vehicles: int, rng: np.random.Generator, *, dt_s: float
    ) -> None:
        self._options, self.rng, self._dt_s = options, rng, dt_s
        steps = math.ceil(options.age_s[1] / dt_s - 1e-9)
        self._arrays: dict[str, FloatArray] = {
            "position_enu_m": np.zeros((num_vehicles, steps + 1, 3)),
            "velocity_enu_mps": np.zeros((num_vehicles, steps + 1, 3)),
            "age_steps": np.zeros(num_vehicles),
            "setpoint_enu_mps": np.zeros((num_vehicles, 3)),
            "target_enu_m": np.zeros((num_vehicles, 3)),
            "target_error_m": np.zeros((num_vehicles, 3)),
            "silent_s": np.zeros(num_vehicles),
            "acceleration_max_mps2": np.ones(num_vehicles),
            "gain": np.ones(num_vehicles),
        }

    @property
    def position_enu_m(self) -> FloatArray:
        """Where the vehicles are known to be, or to have been, ``(N, 3)``."""
        return self._known("position_enu_m")

    @property
    def velocity_enu_mps(self) -> FloatArray:
        """How fast, ``(N, 3)``."""
        return self._known("velocity_enu_mps")

    @property
    def target_enu_m(self) -> FloatArray:
        """Where the targets are known to be, ``(N, 3)``."""
        return self._arrays["target_enu_m"]

    @property
    def acceleration_max_mps2(self) -> FloatArray | None:
        """Their limits, ``(N,)``; ``None`` for the lag's own."""
        if self._options.acceleration_max_mps2 is None:
            return None
        return self._arrays["acceleration_max_mps2"]

    def arrays(self) -> dict[str, FloatArray]:
        """Return everything that changes, by name."""
        return {f"imperfect_{name}": array for name, array in self._arrays.items()}

    def take(self, rows: IntArray) -> "Flown":
        """Return some of the vehicles."""
        taken = Flown(self._options, 0, self.rng, dt_s=self._dt_s)
        taken._arrays = {name: array[rows] for name, array in self._arrays.items()}
        return taken

    def start(
        self,
        rows: IntArray,
        position_enu_m: FloatArray,
        velocity_enu_mps: FloatArray,
        target_enu_m: FloatArray,
    ) -> None:
        """Begin anew in ``rows``, with all known as it is; writes into copies."""
        rng = self.rng
        arrays = {name: array.copy() for name, array in self._arrays.items()}
        noise = self._options.target_noise
        error_m = np.zeros_like(target_enu_m)
        if noise is not None:
            error_m = noise.sample(rng, target_enu_m.shape)
        arrays["position_enu_m"][rows] = position_enu_m[:, None]
        arrays["velocity_enu_mps"][rows] = velocity_enu_mps[:, None]
        arrays["setpoint_enu_mps"][rows] = 0.0
        arrays["target_error_m"][rows] = error_m
        arrays["target_enu_m"][rows] = target_enu_m + error_m
        arrays["silent_s"][rows] = 0.0
        if (most_mps2 := self._options.acceleration_max_mps2) is not None:
            arrays["acceleration_max_mps2"][rows] = rng.uniform(*most_mps2, len(rows))
        arrays["gain"][rows] = 1.0 - rng.uniform(*self._options.shortfall, len(rows))
        arrays["age_steps"][rows] = rng.uniform(*self._options.age_s, len(rows)) / self._dt_s
        self._arrays = arrays

    def receive(self, setpoint_enu_mps: FloatArray) -> FloatArray:
        """Return what the vehicles follow, ``(N, 3)``: these setpoints or the ones before."""
        if self._options.setpoint_loss > 0.0:
            lost = self.rng.random(len(setpoint_enu_mps)) < self._options.setpoint_loss
            before = self._arrays["setpoint_enu_mps"]
            setpoint_enu_mps = np.where(lost[:, None], before, setpoint_enu_mps)
        self._arrays["setpoint_enu_mps"] = setpoint_enu_mps
        reached = self._arrays["gain"][:, None]
        return setpoint_enu_mps * np.concatenate((reached, reached, np.ones_like(reached)), axis=1)

    def look(
        self,
        position_enu_m: FloatArray,
        velocity_enu_mps: FloatArray,
        target_enu_m: FloatArray,
    ) -> None:
        """Let a step pass, after which all is as given, ``(N, 3)`` each."""
        for name, now in (
            ("position_enu_m", position_enu_m),
            ("velocity_enu_mps", velocity_enu_mps),
        ):
            self._arrays[name] = np.concatenate((now[:, None], self._arrays[name][:, :-1]), axis=1)
        if (noise := self._options.target_noise) is not None:
            self._arrays["target_error_m"] = noise.advance(
                self._arrays["target_error_m"], dt_s=self._dt_s, rng=self.rng
            )
        heard_enu_m = target_enu_m + self._arrays["target_error_m"]
        if (silence_s := self._options.target_silence_s) is not None:
            silent_s = self._arrays["silent_s"] - self._dt_s
            begins = (silent_s <= 0.0) & (
                self.rng.random(len(silent_s)) < self._dt_s / silence_s[0]
            )
            silent_s = np.where(begins, silence_s[1], np.maximum(silent_s, 0.0))
            self._arrays["silent_s"] = silent_s
            known_enu_m = self._arrays["target_enu_m"]
            heard_enu_m = np.where((silent_s > 0.0)[:, None], known_enu_m, heard_enu_m)
        self._arrays["target_enu_m"] = heard_enu_m

    def _known(self, name: str) -> FloatArray:
        """Return what is known of a quantity: what it was when the vehicle told, ``(N, 3)``."""
        told = self._arrays[name]
        if told.shape[1] == 1:
            return told[:, 0]
        rows, steps = np.arange(len(told)), self._arrays["age_steps"]
        later = np.minimum(steps.astype(np.int64), told.shape[1] - 2)
        share = (steps - later)[:, None]
        return np.asarray((1.0 - share) * told[rows, later] + share * told[rows, later + 1])
