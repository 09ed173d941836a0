"""What each departure from the paper buys: the obstacle stage, changed one thing at a time.

The first entry is the paper as literally as its errata allow. The next ones add to it; all others
take one thing away from preset ``paper`` as it is. The run from random networks instead of those
of the free stage is no change of the preset, and is trained beside these.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from training.presets import Preset

_RAW_FREE_UPDATES = 40_000
"""The raw state needs this many to learn the free stage, the relative one 6000."""


@dataclass(frozen=True, slots=True)
class Ablation:
    """One named variant of preset ``paper``."""

    name: str
    reason: str
    """One line: what it shows."""
    change: Callable[[Preset], Preset]
    """Of either stage's preset; the free stage it starts from is changed likewise."""
    transfer: bool = True
    """Whether it starts from the networks of a free run."""


def _literal(preset: Preset) -> Preset:
    changed = replace(_literal_but_relative(preset), layout_name="paper")
    if preset.stage == "free":
        return replace(changed, updates=max(preset.updates, _RAW_FREE_UPDATES))
    return changed


def _literal_but_relative(preset: Preset) -> Preset:
    return replace(
        preset,
        num_worlds=64,
        replay_capacity=10_000,
        num_steps=1,
        world=replace(
            preset.world,
            end_on_contact=False,
            restart_probability=0.0,
            arrived_restart_probability=0.0,
        ),
        ddpg=replace(preset.ddpg, twin_critics=False, target_noise=0.0, best_of_samples=0),
    )


def _without_contact_end(preset: Preset) -> Preset:
    return replace(preset, world=replace(preset.world, end_on_contact=False))


def _without_restarts(preset: Preset) -> Preset:
    world = replace(preset.world, restart_probability=0.0, arrived_restart_probability=0.0)
    return replace(preset, world=world)


def _without_samples(preset: Preset) -> Preset:
    return replace(preset, ddpg=replace(preset.ddpg, best_of_samples=0))


def _with_one_critic(preset: Preset) -> Preset:
    return replace(preset, ddpg=replace(preset.ddpg, twin_critics=False))


def _with_short_memory(preset: Preset) -> Preset:
    return replace(preset, replay_capacity=10_000)


ABLATIONS: Mapping[str, Ablation] = {
    ablation.name: ablation
    for ablation in (
        Ablation("literal", "the paper's raw state, buffer and endless episodes", _literal),
        Ablation(
            "literal-relative",
            "the same, but for the state seen from the vehicle: no wrap of psi on the way",
            _literal_but_relative,
        ),
        Ablation(
            "no-contact-end",
            "the vehicle passes through obstacles at a price, as the paper's (E13)",
            _without_contact_end,
        ),
        Ablation(
            "no-restarts",
            "every episode lasts T steps, most of them at the target, where little is learnt",
            _without_restarts,
        ),
        Ablation(
            "no-samples",
            "the gradient alone leads the actor: it stays between left and right, and hovers",
            _without_samples,
        ),
        Ablation("one-critic", "no second critic to damp overestimated values", _with_one_critic),
        Ablation("short-memory", "B = 10000, as in Table I (E11)", _with_short_memory),
    )
}
