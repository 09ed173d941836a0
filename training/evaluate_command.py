"""``training evaluate``: an actor and what it is measured against, on the same cases."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
from rich.console import Console

from companion.arrays import Float32Array
from companion.errors import UsageError
from companion.policy.actor import Actor
from companion.policy.observation import WAYS, Layout
from companion.world.maps import Map
from sim.edge_cases import edge_cases
from sim.guides import Surveyor
from sim.imperfections import POOR_RADIO
from sim.world import CityWorld
from training import cli
from training.baselines_loop import BASELINES
from training.evaluate import Evaluation, Policy, evaluate_policy, fly_straight
from training.evaluation_table import Flown, evaluation_table
from training.loop import Conditions, evaluate_loop
from training.places import Place

_ACTOR, _STRAIGHT = "actor", "straight"


@dataclass(frozen=True, slots=True)
class _Cases:
    """A set of cases."""

    maps: tuple[Map, ...]
    episodes: int
    begin: Callable[[CityWorld], Float32Array] = CityWorld.reset


Results = Mapping[str, Flown]
"""By who flew: ``actor``, ``straight`` and the names of ``BASELINES``."""


def evaluate(options: "cli.Evaluate", typed: str, *, now_s: Callable[[], float]) -> int:
    """Run ``training evaluate``.

    Raises:
        UsageError: If the options contradict each other or ask for what is not there.
    """
    cases = _cases(options)
    actor = Actor.load(options.actor)
    judge = _Judge(actor, options, now_s)
    for city in (city for one in cases.values() for city in one.maps):
        actor.check_fits(city, actor.contract.dynamics.v_max_mps or 0.0)
    results = {}
    for where, one in cases.items():
        with Console(stderr=True).status(f"flying {where}: {one.episodes} cases"):
            results[where] = judge.fly_all(one)
    if options.json:
        said = {
            "actor": actor.name,
            "map": options.map,
            "cities": options.cities,
            "seed": options.seed,
            "moving": options.moving,
            "imperfect": options.imperfect,
            "in_the_loop": judge.in_the_loop,
            "command": typed,
        }
        found = {"edge_cases": results} if options.edge_cases else _flat(*results.values())
        print(msgspec.json.encode({**found, **said}).decode())
        return 0
    console = Console(highlight=False, markup=False, soft_wrap=True)
    how = "asked 20 times a second" if judge.in_the_loop else "by the paper's step"
    console.print(f"{options.episodes} cases, seed {options.seed}, {how}")
    for table in _tables(results, actor.name, edge_cases=options.edge_cases):
        console.print(f"\n{table}")
    shielded = [flown[_ACTOR].with_shield for flown in results.values()]
    if beyond := sum(one.out_of_reach or 0 for one in shielded if one is not None):
        console.print(f"\nout of reach for whoever keeps the shield's margin: {beyond} targets")
    console.print(f"\n{typed}")
    return 0


class _Judge:
    """Flies policies on the terms that an actor was trained for.

    Raises:
        UsageError: If options need a vehicle with a speed, and the actor has none.
    """

    def __init__(self, actor: Actor, options: "cli.Evaluate", now_s: Callable[[], float]) -> None:
        self._actor = actor
        self._contract = actor.contract
        # What was trained on a vehicle with a lag is flown on one; the paper's point has none.
        self.in_the_loop = actor.contract.dynamics.velocity_lag_s is not None
        asked = {
            "--shield": options.shield,
            "--baselines": options.baselines,
            "--edge-cases": options.edge_cases,
            "--imperfect": options.imperfect,
        }
        for option in (option for option, given in asked.items() if given):
            if not self.in_the_loop:
                raise UsageError(
                    f"{option} needs a vehicle with a speed: {actor.name} is evaluated as the "
                    f"paper's kinematic point"
                )
        self._shield, self._baselines = options.shield, options.baselines
        self._surveyor = Surveyor()
        self._conditions = Conditions()
        if options.imperfect:
            self._conditions = Conditions(imperfections=POOR_RADIO)
        self._options: dict[str, Any] = {
            "seed": options.seed,
            "moving": options.moving,
            "measure_clearance": True,
            "now_s": now_s,
        }

    def fly_all(self, cases: _Cases) -> Results:
        """Fly the actor and what it is measured against."""

        def ask(_: CityWorld, observation: Float32Array) -> Float32Array:
            return self._actor.act(observation)

        layout = self._contract.layout
        # Straight behind the shield is one baseline more, for who asks for them.
        shield = self._shield and self._baselines
        flown = {
            _ACTOR: self._fly(ask, layout, cases, shield=self._shield),
            _STRAIGHT: self._fly(fly_straight, layout, cases, shield=shield),
        }
        if self._baselines:
            for name, policy in BASELINES.items():
                flown[name] = self._fly(policy, WAYS, cases, shield=shield)
        return flown

    def _fly(self, policy: Policy, layout: Layout, cases: _Cases, *, shield: bool) -> Flown:
        alone = self._count(policy, layout, cases, shield=False)
        return Flown(alone, self._count(policy, layout, cases, shield=True) if shield else None)

    def _count(self, policy: Policy, layout: Layout, cases: _Cases, *, shield: bool) -> Evaluation:
        v_max_mps = self._contract.dynamics.v_max_mps
        flown = (policy, cases.maps, layout, self._contract.action)
        if v_max_mps is None or not self.in_the_loop:
            return evaluate_policy(*flown, episodes=cases.episodes, **self._options)
        return evaluate_loop(
            *flown,
            v_max_mps=v_max_mps,
            episodes=cases.episodes,
            shield=shield,
            conditions=self._conditions,
            surveyor=self._surveyor,
            begin=cases.begin,
            **self._options,
        )


def _cases(options: "cli.Evaluate") -> dict[str, _Cases]:
    """Return the sets of cases by what they are called."""
    if options.episodes < 1:
        raise UsageError(f"--episodes must be at least 1, got {options.episodes}")
    if not options.edge_cases:
        place = Place(options.map, options.cities)
        maps = place.test_maps()
        if len(maps) > options.episodes:
            raise UsageError(f"--cities {len(maps)} needs at least as many --episodes")
        return {place.label: _Cases(maps, options.episodes)}
    if options.map is not None or options.cities is not None or options.moving:
        raise UsageError("--edge-cases has maps and targets of its own: drop --map, --cities, ...")
    places = edge_cases()
    if len(places) > options.episodes:
        raise UsageError(f"--edge-cases needs at least {len(places)} --episodes")
    share, left = divmod(options.episodes, len(places))
    return {
        place.name: _Cases((place.city,), share + (number < left), place.begin)
        for number, place in enumerate(places)
    }


def _flat(results: Results) -> dict[str, Any]:
    """Return what is said of one place: the actor's numbers first, and each by its name."""
    actor = results[_ACTOR]
    return {
        **msgspec.to_builtins(actor.alone),
        "straight_completion_rate": results[_STRAIGHT].alone.completion_rate,
        "with_shield": actor.with_shield,
        "baselines": {name: flown for name, flown in results.items() if name != _ACTOR},
    }


def _tables(results: Mapping[str, Results], actor: str, *, edge_cases: bool) -> list[str]:
    """Return a table of all who flew; of edge cases one for each of them, a row a case."""
    titles = {name: name.replace("_", " ") for name in BASELINES}
    titles |= {_ACTOR: actor, _STRAIGHT: "flying straight"}
    if not edge_cases:
        (flown,) = results.values()
        return [evaluation_table("", {titles[who]: one for who, one in flown.items()})]
    return [
        evaluation_table(titles[who], {case: flown[who] for case, flown in results.items()})
        for who in next(iter(results.values()))
    ]
