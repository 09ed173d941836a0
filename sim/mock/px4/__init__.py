"""PX4 1.18 as a companion meets it.

Read in this order:

* ``modes``, ``parameters``, ``setpoints``: its vocabulary;
* ``commander``: arming and modes; ``failsafe``, ``ground``, ``health``, ``estimator``: what it
  watches; ``flight``, ``trajectory``: what each mode makes the vehicle do;
* ``incoming``, ``commands``: requests and their answers; ``telemetry``, ``housekeeping``,
  ``undecodable``, ``streams``, ``channel``: messages, their rates, one link.
"""
