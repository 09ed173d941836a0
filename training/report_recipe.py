"""The recipe beside the paper's: every number of Table I and of what it leaves open."""

from training.presets import Preset

Row = tuple[str, str, str]
"""What, the paper's, ours."""


def recipe(free: Preset, obstacles: Preset) -> list[Row]:
    """Return the table of the recipe, both stages where they differ."""

    def both(first: object, second: object) -> str:
        return str(first) if first == second else f"free {first}, obstacles {second}"

    world, options = obstacles.world, obstacles.ddpg
    return [
        ("beta", "4", f"{world.reward.beta:g}, as E4 reads it"),
        ("nu", "0.99", f"tau = {options.tau:g}, as E5 reads it"),
        ("rho_max", "0.2 m", f"{obstacles.rho_max:g} of the edge (E7)"),
        ("T", "100", f"{world.horizon}"),
        ("epsilon", "0.9 to 0.1", both(*(_epsilon(preset) for preset in (free, obstacles)))),
        ("B", "10,000", both(f"{free.replay_capacity:,}", f"{obstacles.replay_capacity:,}")),
        ("N", "256", both(free.batch_size, obstacles.batch_size)),
        (
            "M, updates",
            "40,000 episodes one after the other: 4,000,000",
            both(f"{free.updates:,}", f"{obstacles.updates:,}"),
        ),
        (
            "worlds at once",
            "1",
            both(*(f"{p.num_worlds}, {_ratio(p)}" for p in (free, obstacles))),
        ),
        ("state", "own position, destination", both(_state(free), _state(obstacles))),
        ("end of an episode", "after T steps", both(_ends(free), _ends(obstacles))),
        ("steps in a transition", "1", both(free.num_steps, obstacles.num_steps)),
        (
            "noise on the actor's own actions",
            "none",
            both(f"{free.exploration_noise:g}", f"{obstacles.exploration_noise:g}"),
        ),
        ("layers", "not given", both(_layers(free), _layers(obstacles))),
        ("gamma", "not given", both(f"{free.ddpg.gamma:g}", f"{options.gamma:g}")),
        ("learning rates", "not given", both(_rates(free), _rates(obstacles))),
        ("additions to DDPG", "none", both(_additions(free), _additions(obstacles))),
    ]


def _epsilon(preset: Preset) -> str:
    return f"{preset.epsilon_start:g} to {preset.epsilon_end:g}"


def _ratio(preset: Preset) -> str:
    return f"{preset.updates_per_step} updates for a step of all"


def _state(preset: Preset) -> str:
    if preset.layout_name == "paper":
        return "the paper's six coordinates"
    if preset.layout_name == "relative":
        return "the same, seen from the vehicle: offset, distance and bearing of the destination"
    if preset.layout_name == "rays":
        return (
            "layout `rays`: the way to the destination, and distances to walls and roofs around "
            "the vehicle, computed from the map"
        )
    return f"layout `{preset.layout_name}`"


def _ends(preset: Preset) -> str:
    world = preset.world
    ends = [f"after {world.horizon} steps"]
    if world.end_on_contact:
        ends.append("on contact")
    if world.restart_probability > 0.0:
        ends.append(f"by chance, {world.restart_probability:g} a step")
    if world.arrived_restart_probability > 0.0:
        ends.append(f"by chance at the target, {world.arrived_restart_probability:g} a step")
    return "; ".join(ends)


def _layers(preset: Preset) -> str:
    return " and ".join(str(width) for width in preset.ddpg.hidden)


def _rates(preset: Preset) -> str:
    options = preset.ddpg
    falling = f", falling to {preset.lr_final:g} of it" if preset.lr_final < 1.0 else ""
    return f"actor {options.actor_lr:g}, critic {options.critic_lr:g}{falling}"


def _additions(preset: Preset) -> str:
    options = preset.ddpg
    found = []
    if options.pre_activation_penalty > 0.0:
        found.append(f"penalty {options.pre_activation_penalty:g} on what goes into tanh")
    if options.twin_critics:
        found.append("two critics (TD3)")
    if options.target_noise > 0.0:
        found.append(f"noise {options.target_noise:g} on the target action (TD3)")
    if options.best_of_samples > 0:
        found.append(f"{options.best_of_samples} sampled actions compete with the actor's")
    return "; ".join(found) or "none"
