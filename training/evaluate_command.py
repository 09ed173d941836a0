"""``training evaluate``: an actor and what it is measured against, on the same cases."""

import multiprocessing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import repeat
from typing import Any

import msgspec
from rich.console import Console

from companion import clock
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
from training.evaluate import Policy, evaluate_policy, fly_straight
from training.evaluation_table import Flown, evaluation_table
from training.loop import Conditions, LoopFlights, fly_part
from training.parts import Part, parts_of
from training.places import Place

_ACTOR, _STRAIGHT = "actor", "straight"

Begin = Callable[[CityWorld], Float32Array]
"""Starts the cases in all worlds and returns what is seen first."""


@dataclass(frozen=True, slots=True)
class _Cases:
    """A set of cases."""

    maps: tuple[Map, ...]
    episodes: int
    begin: Begin = CityWorld.reset


Results = Mapping[str, Flown]
"""By who flew: ``actor``, ``straight`` and the names of ``BASELINES``."""

_Pair = tuple[LoopFlights, LoopFlights | None]
"""A policy's flights of one part alone, and with the shield where it was asked for."""


def evaluate(options: "cli.Evaluate", typed: str, *, now_s: Callable[[], float]) -> int:
    """Run ``training evaluate``.

    Raises:
        UsageError: If the options contradict each other or ask for what is not there.
    """
    if options.processes < 1:
        raise UsageError(f"--processes must be at least 1, got {options.processes}")
    cases = _cases(options)
    judge = _Judge(options, now_s)
    for city in (city for one in cases.values() for city in one.maps):
        judge.actor.check_fits(city, judge.contract.dynamics.v_max_mps or 0.0)
    with Console(stderr=True).status("flying") as status:
        results = _fly(judge, cases, options, status.update)
    if options.json:
        said = {
            "actor": judge.actor.name,
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
    for table in _tables(results, judge.actor.name, edge_cases=options.edge_cases):
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

    def __init__(self, options: "cli.Evaluate", now_s: Callable[[], float]) -> None:
        self.actor = Actor.load(options.actor)
        self.contract = self.actor.contract
        # What was trained on a vehicle with a lag is flown on one; the paper's point has none.
        self.in_the_loop = self.contract.dynamics.velocity_lag_s is not None
        asked = {
            "--shield": options.shield,
            "--baselines": options.baselines,
            "--edge-cases": options.edge_cases,
            "--imperfect": options.imperfect,
            "--processes": options.processes > 1,
        }
        for option in (option for option, given in asked.items() if given):
            if not self.in_the_loop:
                raise UsageError(
                    f"{option} needs a vehicle with a speed: {self.actor.name} is evaluated as the "
                    f"paper's kinematic point"
                )
        self._options = options
        self._how: dict[str, Any] = {
            "seed": options.seed,
            "moving": options.moving,
            "measure_clearance": True,
            "now_s": now_s,
        }

    def fly_part(self, part: Part, begin: Begin) -> dict[str, _Pair]:
        """Fly the actor and what it is measured against in the control loop."""
        options, layout = self._options, self.contract.layout
        surveyor = Surveyor()
        conditions = Conditions(imperfections=POOR_RADIO) if options.imperfect else Conditions()

        def fly(policy: Policy, layout: Layout, shield: bool) -> LoopFlights:
            return fly_part(
                policy,
                part,
                layout,
                self.contract.action,
                v_max_mps=self.contract.dynamics.v_max_mps or 0.0,
                shield=shield,
                conditions=conditions,
                surveyor=surveyor,
                begin=begin,
                **self._how,
            )

        # Straight behind the shield is one baseline more, for who asks for them.
        shielded = options.shield and options.baselines
        policies: dict[str, tuple[Policy, Layout, bool]] = {
            _ACTOR: (self._ask, layout, options.shield),
            _STRAIGHT: (fly_straight, layout, shielded),
        }
        if options.baselines:
            policies |= {name: (policy, WAYS, shielded) for name, policy in BASELINES.items()}
        return {
            name: (fly(policy, seen, False), fly(policy, seen, True) if shield else None)
            for name, (policy, seen, shield) in policies.items()
        }

    def count_kinematic(self, cases: _Cases) -> Results:
        """Count the actor and straight flights by the paper's step."""
        where = cases.maps, self.contract.layout, self.contract.action
        return {
            name: Flown(evaluate_policy(policy, *where, episodes=cases.episodes, **self._how), None)
            for name, policy in ((_ACTOR, self._ask), (_STRAIGHT, fly_straight))
        }

    def _ask(self, _: CityWorld, observation: Float32Array) -> Float32Array:
        return self.actor.act(observation)


def _fly(
    judge: _Judge,
    cases: Mapping[str, _Cases],
    options: "cli.Evaluate",
    tell: Callable[[str], None],
) -> dict[str, Results]:
    """Return what came of every set of cases."""
    if not judge.in_the_loop:
        return {name: judge.count_kinematic(one) for name, one in cases.items()}
    work = [
        (name, part, one.begin)
        for name, one in cases.items()
        for part in parts_of(one.maps, one.episodes)
    ]
    flown: dict[str, list[dict[str, _Pair]]] = {name: [] for name in cases}
    names, parts, begins = zip(*work, strict=True)
    with _workers(options.processes) as map_:
        done = map_(_fly_part, repeat(options), parts, begins)
        for number, (name, pairs) in enumerate(zip(names, done, strict=True), start=1):
            flown[name].append(pairs)
            tell(f"flown {name}: {number} of {len(work)} parts")
    return {name: _counted(parts) for name, parts in flown.items()}


@contextmanager
def _workers(processes: int) -> Iterator[Callable[..., Iterable[dict[str, _Pair]]]]:
    """Return what calls a function on one item after the other, ``processes`` at a time."""
    if processes == 1:
        yield map
        return
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
        yield pool.map


def _fly_part(options: "cli.Evaluate", part: Part, begin: Begin) -> dict[str, _Pair]:
    return _Judge(options, clock.now_s).fly_part(part, begin)


def _counted(parts: Sequence[dict[str, _Pair]]) -> Results:
    """Return what came of all parts of a set of cases."""
    results = {}
    for who in parts[0]:
        alone, with_shield = zip(*(pairs[who] for pairs in parts), strict=True)
        shielded = [flown for flown in with_shield if flown is not None]
        results[who] = Flown(
            LoopFlights.joined(alone).evaluation(),
            LoopFlights.joined(shielded).evaluation() if shielded else None,
        )
    return results


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
