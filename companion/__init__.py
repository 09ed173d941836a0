"""Fly a trained policy on a PX4 or ArduPilot vehicle over MAVLink.

Read in this order:

* ``world``: frames, obstacles and map files: what the vehicle knows of its surroundings;
* ``policy``: observation layouts, the spherical action and the actor file: the contract
  between training and flight;
* ``vehicle``: the values and the protocol that stand between the loop and any vehicle;
* ``guidance``: target tracks, the proposed velocity, the shield, the supervisor;
* ``link``: MAVLink bytes; ``session``: what a run leaves behind;
* ``control``: the loop, on one screen; ``cli``: the commands.
"""
