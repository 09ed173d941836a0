"""What a run leaves behind: a folder that opens in Rerun, and the report read from it.

``records`` is what the flying process hands over and ``recorder`` how it does so without ever
waiting; ``recorder_process`` is the process at the other end, the only one that imports Rerun
(``rerun_log``, ``scene``, ``blueprint``) and writes ``flight.tlog`` (``tlog``). ``folder`` names
the files and writes ``summary.json``; ``review`` reads a session back.
"""
