"""What each departure from the paper buys: the obstacle stage, changed one thing at a time.

The first entries climb from the paper as literally as its errata allow to preset ``paper``, each
with one thing more than the entry before; the others change one thing of the preset itself. The
run from random networks instead of those of the free stage is no change of the preset, and is
trained beside these.
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
    """Return the paper's state, world and number of worlds, with layers wide enough for it."""
    changed = replace(
        _only_rays(preset),
        layout_name="paper",
        ddpg=replace(preset.ddpg, hidden=(256, 256), pre_activation_penalty=0.003),
    )
    if preset.stage == "free":
        return replace(changed, updates=max(preset.updates, _RAW_FREE_UPDATES))
    return changed


def _only_relative(preset: Preset) -> Preset:
    return replace(_only_rays(preset), layout_name="relative")


def _only_rays(preset: Preset) -> Preset:
    world = replace(preset.world, end_on_contact=False, restart_probability=0.0)
    return replace(preset, world=world, num_worlds=64)


def _many_worlds(preset: Preset) -> Preset:
    return _without_contact_end(_without_restarts(preset))


def _without_restarts(preset: Preset) -> Preset:
    return replace(preset, world=replace(preset.world, restart_probability=0.0))


def _without_contact_end(preset: Preset) -> Preset:
    return replace(preset, world=replace(preset.world, end_on_contact=False))


def _relative(preset: Preset) -> Preset:
    return replace(preset, layout_name="relative")


def _large_buffer(preset: Preset) -> Preset:
    return replace(preset, replay_capacity=400_000)


def _three_steps(preset: Preset) -> Preset:
    return replace(preset, num_steps=3)


ABLATIONS: Mapping[str, Ablation] = {
    ablation.name: ablation
    for ablation in (
        Ablation("literal", "the paper's six coordinates, in endless episodes", _literal),
        Ablation(
            "only-relative",
            "its state seen from the vehicle: no wrap of psi, but still a map to learn by heart",
            _only_relative,
        ),
        Ablation("only-rays", "the state shows what the map holds around the vehicle", _only_rays),
        Ablation(
            "more-worlds", "and 256 worlds instead of 64, each with its own case", _many_worlds
        ),
        Ablation(
            "contact-end",
            "and contact ends the episode: all but exploring starts",
            _without_restarts,
        ),
        Ablation(
            "no-contact-end",
            "the preset, but the vehicle passes through obstacles at a price (E13)",
            _without_contact_end,
        ),
        Ablation("relative", "the preset, but the state does not show the map", _relative),
        Ablation("large-buffer", "the preset, but B = 400,000 instead of 10,000", _large_buffer),
        Ablation("three-steps", "the preset, but returns of three steps", _three_steps),
    )
}
