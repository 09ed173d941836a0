"""A MAVLink autopilot on a socket, for demos, for tests and for other people's companions.

``python -m sim.mock --help`` is its manual. It builds its messages with pymavlink itself and
never imports ``companion.link``: a mock that shared the companion's codec would share its
mistakes. Everything but ``sockets``, ``process`` and ``cli`` is free of I/O and takes the time
as an argument, so a test flies hundreds of flights on a virtual clock.

Read in this order:

* ``dynamics``: the point mass; ``estimator``, ``geodesy``, ``pilot``, ``health``,
  ``parameters``, ``setpoints``: what every autopilot has; ``autopilot``: all of it together;
* ``telemetry``, ``streams``, ``commands``, ``incoming``, ``channel``: what every autopilot does
  with messages; ``personality``: what makes one of them;
* ``px4`` and ``ardupilot``: the two personalities, each with a reading order of its own;
* ``packet``, ``signing``: messages on their way, and who may speak;
* ``vehicle``: an autopilot and its links, with ``placement`` on a map, ``targets``, a
  ``referee`` of the flight, the ``conduct`` of the companions, ``faults`` and ``wire``, what is
  wrong with a link;
* ``bench``: the same in process, on a virtual clock; ``sockets``, ``process``, ``cli``,
  ``manual``: the shell;
* ``conformance`` and ``fit``: the mock against recorded flights.
"""
