"""Reads a flight back and says what happened: a session of ours, a recording, or any ``.tlog``.

``log_file`` cuts a telemetry log into frames and ``senders`` finds the vehicle among those who
speak in it. ``story`` collects what happened; ``requests``, ``modes``, ``setpoints``, ``health``,
``others`` and ``link_quality`` each tell their part of it, ``motion_log`` samples where the vehicle
was, and ``log_story`` puts them together. ``sources`` opens whatever path it is given as a
``Flight``; ``words`` says it for a terminal, ``page`` writes it as HTML, and ``compare`` lays two
side by side.
"""
