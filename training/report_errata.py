"""Where the paper contradicts itself or is silent, and what is done here: both values."""

from typing import NamedTuple


class Erratum(NamedTuple):
    """One row of the errata table."""

    number: str
    paper: str
    problem: str
    ours: str


ERRATA = (
    Erratum(
        "E1",
        "y += rho sin(phi)",
        "sin(psi) is missing: y could never decrease",
        "y += rho sin(phi) sin(psi)",
    ),
    Erratum(
        "E2",
        '"phi = pi moves along the Z axis"',
        "cos(pi) = -1: it moves down",
        "the equation as it stands; phi = 0 is up, phi = pi is down",
    ),
    Erratum(
        "E3",
        'psi "inclination", phi "elevation"',
        "psi in [0, 2 pi] is an azimuth, phi in [0, pi] a polar angle",
        "called azimuth and polar angle",
    ),
    Erratum(
        "E4",
        "beta = 4",
        "1 - beta = -3 would punish reaching the target",
        "the ratio beta / (1 - beta) = 4, so beta = 0.8; 0.4 is measured beside it",
    ),
    Erratum(
        "E5",
        "nu = 0.99 weighs the new parameters of the targets",
        "there would be no target networks",
        "tau = 1 - nu = 0.01",
    ),
    Erratum(
        "E6",
        "gamma, learning rates, layers and optimiser are not given",
        "silent",
        "in the preset, each with its reason: `training/presets.py`",
    ),
    Erratum(
        "E7",
        "rho_max = 0.2 m",
        "100 steps of 0.2 m do not cross 100 m",
        "0.2 of the edge: 20 m a step",
    ),
    Erratum(
        "E8",
        "step time and largest speed are not given",
        "silent",
        "20 m at 5 m/s: 4 s a step",
    ),
    Erratum(
        "E9",
        '"reached its target"',
        "no radius is given",
        "nearer than 5 m, no contact before, within 100 steps; 2 m and 1 m beside it",
    ),
    Erratum(
        "E10",
        "what a crash does in a test is not given",
        "silent",
        "any contact before the arrival is a failure",
    ),
    Erratum(
        "E11",
        "B = 10000",
        "forgets within a few steps of many worlds at once",
        "see the recipe; the ablation large-buffer shows what more memory does",
    ),
    Erratum(
        "E12",
        "env1 and env2 are drawn without numbers",
        "nobody can rebuild them",
        "`maps/env1.yaml`, `maps/env2.yaml`; how hard they are: see flying straight",
    ),
    Erratum(
        "E13",
        "the vehicle flies on through obstacles, at a price",
        "training and test disagree on what a crash is",
        "see the recipe, and the ablation no-contact-end for the paper's way",
    ),
    Erratum(
        "E14",
        "what happens at the border of the area is not given",
        "silent",
        "positions are held inside the box",
    ),
)
