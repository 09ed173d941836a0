"""ArduCopter 4.6.3 as a companion meets it.

Read in this order:

* ``modes``, ``parameters``, ``setpoints``: its vocabulary;
* ``copter``: arming, modes and take-off; ``radio``: the pilot's transmitter; ``checks``,
  ``boot``, ``estimator``, ``failsafe``, ``ground``: what it goes through and watches; ``flight``,
  ``controllers``, ``steering``: what each mode makes the vehicle do;
* ``incoming``, ``commands``: requests and their answers; ``telemetry``, ``housekeeping``,
  ``streams``, ``channel``: messages, their rates, one link.
"""
