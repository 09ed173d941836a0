"""Every number of an experiment in one place, with its source.

``paper`` is the paper's learner: its reward, epsilon-greedy, buffer, batch, T, one critic, one-step
targets; what it leaves open (E6) is ours. Among obstacles three things are not the paper's, and
``ablations`` shows what each of them buys:

- The state is layout ``rays``: what the map holds around the vehicle. From the paper's six
  coordinates alone networks of this size do not learn six obstacles by heart: the raw state
  completed at most 10 % of validation cases in 16,500 updates; layout ``relative`` stayed at 80 %
  in 24,000, with contact ending the episode, restarts, two critics, sampled actions and a large
  buffer. With ``rays`` and nothing else changed: 84 to 94 % from 6000 updates on, in swings.
- Contact ends the episode (E13): crossing a corner costs less than a contact is worth to us.
- Exploring starts: an episode ends early with a chance of 2 % a step, as most of T = 100 steps
  would be spent at the target. They are spread over 256 worlds at once.

The raw state does learn the free stage: wide layers and 40,000 updates completed 99.3 and 100 %
of 1000 held-out cases. ``rays`` and ``relative`` complete all of them after 3000 to 6000.

``coordinates`` asks how far the paper's six coordinates go: the state is layout ``relative``, which
is computed from them alone, and the obstacles must be learnt by heart. World and reward are the
paper's, contact ends the episode; how it learns is ``flight``'s: twin critics, returns of several
steps, sampled actions, a large buffer, little noise. Half of its time-outs hover 5 to 10 m
off the target, where episodes end by a chance of 0.2 a step: longer stays are the next to try.

``flight`` is the same algorithm free to use what makes it work: rays around the vehicle and the way
round (layout ``ways``), contact ends the episode, five-step returns, twin critics, and sampled
actions that compete with the actor's own. It trains on what flies: a decision every two seconds
(10 m at 5 m/s), a vehicle that lags, accelerates and falls short by what it does not know, climbs
at 3 and descends at 1.5 m/s, in gusts, with an estimate that wavers and comes late. gamma keeps the
paper world's horizon in seconds: 0.95 per 4 s. Its reward is the paper's with beta raised, as
guidance is paid for every step and a crash once, with a term for the last metres, and with the
distance to the target measured along the way: where hovering before a wall pays nearly as much as
arriving behind it, the actor learns to hover, and rays cannot show it the way out of a court. It is
judged in the control loop.

Its angles are measured from the aim, phi as well as psi. While phi was measured from the vertical,
an actor had to hold its output at the end of tanh to fly straight down, and of ten flights that
timed out (950 validation cases) nine hung high above an aim below them; since zero flies at the aim
none does. ``keep_m`` is the margin of the shield.

The shipped actor is two commands, from fresh networks, at one revision (84cfda83)::

    training train --preset flight --stage free --seed 2 --out runs/flight-free
    training train --preset flight --stage obstacles --cities 64 --seed 2 --init runs/flight-free

Of the validations of three seeds it was the best: the averaged actor after 5000 of 10,000 updates,
100, 99.5 and 96.3 % within 5, 2 and 1 m. The best of seed 1: 100, 98.5 and 93.0 %, of seed 0: 99.8,
99.0 and 95.5 %, both the averaged actor after 2500. Later ones complete as many, less precisely.

A preset has a stage ``free`` (the paper's source task) and a stage ``obstacles`` that starts
from the networks of the first.
"""

import hashlib
from dataclasses import dataclass, field, replace
from typing import Literal

import msgspec

from companion.errors import UsageError
from companion.policy.action import (
    AIM_SCALING,
    PAPER_SCALING,
    TARGET_SCALING,
    ActionScaling,
)
from companion.policy.observation import LAYOUTS, Layout
from sim.dynamics import Disturbance, VelocityLag, VerticalLimits
from sim.imperfections import Imperfections
from sim.motion import Dynamics
from sim.reward import Reward

PresetName = Literal["paper", "coordinates", "flight"]
StageName = Literal["free", "obstacles"]
LayoutName = Literal["paper", "relative", "rays", "ways"]
DeviceName = Literal["cpu", "cuda"]
"""Where the networks live; the worlds stay on the CPU."""


@dataclass(frozen=True, slots=True)
class DdpgOptions:
    """What the learner does; the paper gives tau and the batch size only (E6)."""

    hidden: tuple[int, ...] = (128, 128)
    """Widths of the ReLU layers of actor and critic."""
    gamma: float = 0.95
    """Discount per step: a horizon of 20 steps, four times the way across the map."""
    actor_lr: float = 5e-4
    critic_lr: float = 1e-3
    tau: float = 0.01
    """Weight of the new parameters in the target networks: 1 - nu (E5)."""
    pre_activation_penalty: float = 0.01
    """Weight of the squared input of tanh in the actor's loss (the action penalty of hindsight
    experience replay's DDPG); both presets have it. Without it the actor saturates and stops
    learning."""
    twin_critics: bool = False
    """Two critics, the smaller value in the target: TD3's clipped double Q."""
    target_noise: float = 0.0
    """Standard deviation of TD3's noise on the target action, clipped at twice itself."""
    best_of_samples: int = 0
    """How many random actions compete with the actor's own, half of them anywhere, half near it;
    the actor is drawn to the one that the critic likes best. The gradient alone stays in the
    local optimum between left and right around an obstacle, and hovers. 0: the gradient alone."""
    best_of_share: float = 0.25
    """Share of the batch on which they compete."""
    best_of_weight: float = 1.0
    """Weight of the squared distance to the best of them. The shorter the step, the less one
    action changes the value: this and the penalty above must shrink with it."""
    average_tau: float = 0.001
    """Weight of the new parameters in the averaged actor, evaluated beside the actor."""


@dataclass(frozen=True, slots=True)
class WorldOptions:
    """The world the actor learns in."""

    horizon: int = 100
    """T of Table I."""
    arrival_radius_m: float = 5.0
    """Success, which the paper leaves open (E9)."""
    reward: Reward = field(default_factory=Reward)
    """The paper's, with its beta = 4 read as beta / (1 - beta) (E4); other terms are named."""
    end_on_contact: bool = False
    """The paper's vehicle passes through obstacles at a price (E13)."""
    restart_probability: float = 0.0
    """Chance per step of a new episode: exploring starts."""
    arrived_restart_probability: float = 0.0
    """Added to it at the target, where there is less to learn than on the way."""
    dynamics: Dynamics = field(default_factory=Dynamics)
    """How the vehicle moves; by default the paper's kinematic point."""
    imperfections: Imperfections | None = field(default=None, repr=False)
    """What else vehicles with a lag and their links are like."""


@dataclass(frozen=True, slots=True)
class Preset:
    """One experiment."""

    name: PresetName
    stage: StageName
    layout_name: LayoutName
    rho_max: float = 0.2
    """Longest step as a share of the edge (Table I). At 5 m/s it is also the step's time (E8)."""
    world: WorldOptions = field(default_factory=WorldOptions)
    ddpg: DdpgOptions = field(default_factory=DdpgOptions)
    batch_size: int = 256
    """N of Table I."""
    replay_capacity: int = 10_000
    """B of Table I (E11)."""
    num_steps: int = 1
    """Steps of reward in one transition; the paper's is one."""
    epsilon_start: float = 0.9
    """Table I: chance of a random action at first,"""
    epsilon_end: float = 0.1
    """and at last."""
    epsilon_fraction: float = 0.5
    """Share of the run over which epsilon falls; the paper does not say."""
    exploration_noise: float = 0.0
    """Standard deviation of the noise on the actor's own actions."""
    lr_final: float = 1.0
    """Learning rates fall linearly over the run, to this share of their first value."""
    num_worlds: int = 64
    """Worlds stepped at once; the paper's M = 40000 episodes ran one after the other."""
    updates_per_step: int = 4
    """Gradient steps for each step of all worlds."""
    warmup_steps: int = 20
    """Steps of all worlds before the first update."""
    updates: int = 12_000
    """Length of the run. The paper's is 4 million."""
    validate_every: int = 1_000
    """Updates between validations."""
    validation_episodes: int = 1_000

    @property
    def layout(self) -> Layout:
        """Return the observation layout."""
        return LAYOUTS[self.layout_name]

    @property
    def scaling(self) -> ActionScaling:
        """Return the action's meaning: angles are measured the way the layout sees the target."""
        scaling = PAPER_SCALING if self.layout_name == "paper" else TARGET_SCALING
        if self.layout.shows_way:
            scaling = AIM_SCALING
        return msgspec.structs.replace(scaling, rho_max=self.rho_max)

    @property
    def digest(self) -> str:
        """Return a hash of every number: a run may only go on, or be exported, with its own."""
        # Where there are no imperfections nothing is said of them, as before there were any.
        others = self.world.imperfections
        numbers = repr(self) if others is None else repr((self, others))
        return hashlib.sha256(numbers.encode()).hexdigest()[:12]

    @property
    def in_the_loop(self) -> bool:
        """Whether its actors are judged in the control loop instead of the kinematic world."""
        return self.world.dynamics.lag is not None


def load_preset(
    name: PresetName,
    stage: StageName,
    *,
    layout: LayoutName | None = None,
    updates: int | None = None,
    beta: float | None = None,
) -> Preset:
    """Return a preset, with the few numbers that the command line may change.

    Args:
        name: ``paper`` or ``flight``.
        stage: ``free`` or ``obstacles``.
        layout: Another observation layout than the preset's.
        updates: Another length of the run.
        beta: Another weight of the obstacle penalty.

    Raises:
        UsageError: If a number makes no sense, the paper's literal ``beta = 4`` among them.
    """
    preset = PRESETS[name, stage]
    if layout is not None:
        preset = replace(preset, layout_name=layout)
    if updates is not None:
        if updates < 1:
            raise UsageError(f"--updates must be at least 1, got {updates}")
        preset = replace(preset, updates=updates)
    if beta is not None:
        reward = replace(preset.world.reward, beta=_checked_beta(beta))
        preset = replace(preset, world=replace(preset.world, reward=reward))
    return preset


def _checked_beta(beta: float) -> float:
    if 0.0 <= beta < 1.0:
        return beta
    if beta == 4.0:
        raise UsageError(
            "--beta 4 is the paper's literal value and would punish reaching the target "
            "(1 - beta = -3): it is the ratio beta / (1 - beta), so ask for --beta 0.8"
        )
    raise UsageError(f"--beta must be in [0, 1), got {beta:g}")


_PAPER_FREE = Preset(
    name="paper",
    stage="free",
    layout_name="rays",
    lr_final=0.05,
    updates=6_000,
    validate_every=1_000,
)

_COORDINATES_FREE = Preset(
    name="coordinates",
    stage="free",
    layout_name="relative",
    world=WorldOptions(restart_probability=0.02, arrived_restart_probability=0.2),
    ddpg=DdpgOptions(
        actor_lr=3e-4,
        pre_activation_penalty=0.004,
        twin_critics=True,
        target_noise=0.03,
        best_of_samples=8,
        best_of_weight=0.4,
    ),
    replay_capacity=400_000,
    num_steps=3,
    epsilon_start=0.05,
    epsilon_end=0.01,
    exploration_noise=0.05,
    lr_final=0.05,
    updates=3_000,
    validate_every=1_000,
)

_FLYING = Dynamics(
    lag=VelocityLag(),
    time_constant_s=(0.3, 1.0),
    vertical=VerticalLimits(),
    wind=Disturbance(std=0.5, correlation_s=2.0),
    position_noise=Disturbance(std=0.3, correlation_s=2.0),
    start_speed_mps=5.0,
    substeps=4,
)
_FLOWN = Imperfections(
    acceleration_max_mps2=(1.5, 4.0),
    shortfall=(0.0, 0.16),
    age_s=(0.0, 0.2),
    target_noise=Disturbance(std=0.3, correlation_s=2.0),
    target_silence_s=(10.0, 1.0),
)
"""From the slowest that was recorded (ArduCopter 1.6 m/s2, PX4 2.5) to PX4's MPC_ACC_HOR and
beyond. No setpoint is lost: a step is two seconds long, and no link is silent for that long."""

_FLIGHT_FREE = Preset(
    name="flight",
    stage="free",
    layout_name="ways",
    rho_max=0.1,
    world=WorldOptions(
        horizon=60,
        reward=Reward(beta=0.96, arrival_weight=9.0, keep_m=2.0, keep_weight=0.02),
        restart_probability=0.02,
        arrived_restart_probability=0.2,
        dynamics=_FLYING,
        imperfections=_FLOWN,
    ),
    ddpg=DdpgOptions(gamma=0.9747, pre_activation_penalty=0.001, twin_critics=True),
    num_steps=5,
    lr_final=0.05,
    updates=3_000,
    validate_every=1_000,
    validation_episodes=400,
)

PRESETS: dict[tuple[PresetName, StageName], Preset] = {
    ("paper", "free"): _PAPER_FREE,
    ("paper", "obstacles"): replace(
        _PAPER_FREE,
        stage="obstacles",
        world=WorldOptions(end_on_contact=True, restart_probability=0.02),
        num_worlds=256,
        updates=16_000,
    ),
    ("coordinates", "free"): _COORDINATES_FREE,
    ("coordinates", "obstacles"): replace(
        _COORDINATES_FREE,
        stage="obstacles",
        world=replace(_COORDINATES_FREE.world, end_on_contact=True),
        num_worlds=256,
        updates=40_000,
        validate_every=2_500,
    ),
    ("flight", "free"): _FLIGHT_FREE,
    ("flight", "obstacles"): replace(
        _FLIGHT_FREE,
        stage="obstacles",
        world=replace(_FLIGHT_FREE.world, end_on_contact=True),
        ddpg=replace(
            _FLIGHT_FREE.ddpg,
            actor_lr=2e-4,
            pre_activation_penalty=0.004,
            target_noise=0.03,
            best_of_samples=16,
            best_of_weight=0.4,
        ),
        replay_capacity=400_000,
        epsilon_start=0.05,
        epsilon_end=0.01,
        exploration_noise=0.05,
        num_worlds=256,
        updates=10_000,
        validate_every=2_500,
    ),
}
