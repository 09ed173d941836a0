"""What a run leaves behind: a folder that opens in Rerun, and the report read from it.

``records`` is what the flying process hands over and ``recorder`` how it does so without ever
waiting; ``recorder_process`` is the process at the other end, the only one that imports Rerun
(``rerun_log``, ``scene``, ``blueprint``) and writes ``flight.tlog`` (``tlog``). ``folder`` names
the files and writes ``summary.json``; ``readback`` reads a recording into a ``flight``, which is
what ``companion.review`` shows.

Recordings are written by the Rerun that is pinned in ``pyproject.toml``. Its viewers open what the
minor version before and after them wrote; ``rerun rrd migrate FILE`` brings an older file forward.
The layout is stored in the file. What must outlast any viewer is not in it alone: ``flight.tlog``
is standard, and ``summary.json`` is plain; ``companion review`` makes the picture from these too.
"""
