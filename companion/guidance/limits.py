"""The numbers of the supervisor: how long it waits, and what it counts as too much."""

ARRIVAL_RADIUS_M = 5.0
"""PAPER E9: the paper gives no radius; its text admits a lack of precision."""
PREFLIGHT_TIMEOUT_S = 90.0
"""ArduCopter takes 42 s from power-up to a usable position (measured)."""
TAKEOFF_TIMEOUT_S = 60.0
HANDOVER_TIMEOUT_S = 4.0
"""PX4 shows a mode change in its next 1 Hz HEARTBEAT; this allows for three lost ones."""
IDLE_STREAM_S = 0.6
"""Zero setpoints before OFFBOARD is asked for; PX4 needs one that is younger than 1 s."""
POSITION_STALE_SOFT_S = 0.25
POSITION_STALE_HARD_S = 0.5
HEARTBEAT_LATE_S = 3.0
"""Without a HEARTBEAT nobody knows who has the vehicle: it is held; two may be lost."""
LINK_LOST_S = 5.0
TARGET_LOST_S = 10.0
HOLDING_LIMIT_S = 10.0
"""A hold of ours is zero velocity, which drifts; after this the autopilot's own hold takes over."""
DOUBT_LIMIT_S = 5.0
"""The same where the position is in doubt and the shield cannot lean against the drift: gusts of
0.5 m/s that last 2 s carry a vehicle off by 1.8 m in that time (one standard deviation), and by
2.8 m in ten seconds. An origin that moved, and was not heard of for 3 s, is tied anew in less."""
NO_PROGRESS_S = 60.0
"""So long without coming ``PROGRESS_M`` nearer to the target than ever before."""
PROGRESS_M = 1.0
OFF_MAP_M = 10.0
"""Gusts and noise may carry a vehicle out of the box by a metre or two, and the shield leads it
back; farther out it was flown by somebody else, or does not know where it is. A target so far
outside is not followed."""
FRAME_SETTLE_S = 1.0
"""Zero velocity after the local frame has moved, while the new tie is looked at."""
POLICY_FAILURES = 3
TAKEOFF_TOLERANCE_M = 1.0
"""A climb counts as finished so far below the asked height (PX4's NAV_MC_ALT_RAD is 0.8 m), or
a tenth of it where that is more."""
FRESH_HEARTBEAT_S = 0.2
"""The external mode is asked for on a HEARTBEAT this young: a pilot's change shows in the next."""
KNOWN_MODE_S = 1.5
"""On an older HEARTBEAT nothing is asked of the vehicle: the pilot may have it by now."""
STALL_S = 0.3
"""The loop was away so long (swapped out, stopped): first look, then act."""
CATCH_UP_S = 0.25
STREAM_GAP_S = 0.8
"""After a longer gap PX4 may have left OFFBOARD (COM_OF_LOSS_T is 1 s) and would take it back by
itself if the stream went on: silence, until a new HEARTBEAT tells."""
BATTERY_ENGAGE = 0.25
BATTERY_HANDOVER = 0.15
