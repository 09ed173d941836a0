"""A MAVLink autopilot on a socket, for demos, for tests and for other people's companions.

``python -m sim.mock --help`` is its manual. It builds its messages with pymavlink itself and
never imports ``companion.link``: a mock that shared the companion's codec would share its
mistakes. Everything but ``sockets``, ``process`` and ``cli`` is free of I/O and takes the time
as an argument, so a test flies hundreds of flights on a virtual clock.

Read in this order:

* ``dynamics``: the point mass; ``modes``, ``parameters``, ``setpoints``: PX4's vocabulary;
* ``px4``: arming and modes; ``failsafe``, ``ground``, ``health``, ``estimator``, ``pilot``: what
  it watches; ``flight``: what each mode makes the vehicle do;
* ``incoming``, ``commands``: requests and their answers; ``telemetry``, ``housekeeping``,
  ``undecodable``, ``streams``: messages and their rates; ``channel``: one link;
* ``vehicle``: all of it together, with ``placement`` on a map, ``targets``, a ``referee``,
  ``faults`` and ``wire``, what is wrong with a link;
* ``bench``: the same in process, on a virtual clock; ``sockets``, ``process``, ``cli``: the shell.
"""
