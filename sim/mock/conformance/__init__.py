"""The mock against recordings of real autopilots: ``python -m sim.mock.conformance FLIGHT.tlog``.

What was sent to the real one is sent to the mock at the same moments of the autopilot's own
clock; then answers, timelines, rates and the way flown are compared, and a table says how far
they agree. Nothing here knows any particular recording.

Read in this order:

* ``recording``: a log on the autopilot's clock, and what it says about where and what it was;
* ``surroundings``: what reached the vehicle by other ways than this link;
* ``replay``: the same requests for the mock;
* ``timelines``, ``requests``, ``motion``: what is compared, each as rows of the table;
* ``compare``: all of them; ``table``: the rows as text.
"""
