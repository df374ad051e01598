"""What to do about each reason: the only text of docs/reference/states.md that no other module has."""

from __future__ import annotations

from collections.abc import Mapping

from formation.protocol.reasons import Code

SENSORS = (
    "Check wheels, motors, the source of the position, and whether `cmd_vel` names the message type that the"
    " robot takes; the robot probes and goes on by itself."
)
HAND = "Put the robot down and leave it alone; check that the source tracks this robot. It goes on by itself."
WAIT = "Nothing; this is normal at the start. If it stays,"
MISSIONS = (
    "Give all processes the same mission (`formation deploy push`); restart those that run the old one."
)
CLOCKS = "Synchronise the clocks (chrony); `formation doctor` names the process."
ADVICE: Mapping[Code, str] = {
    Code.STARTED: "Nothing.",
    Code.ENDED: "Nothing if it was ended on purpose; else read its log and start it again.",
    Code.DETAIL: "Read the text. Only recordings of earlier versions contain this reason.",
    Code.STOPPED_BY_OPERATOR: "`formation order MISSION release`, then `run`.",
    Code.HELD_BY_OPERATOR: "`formation order MISSION run`.",
    Code.STOPPED_BEFORE_START: "The stop was saved and is still in force: `release`, then `run`.",
    Code.HELD_BEFORE_START: "The hold was saved and is still in force: `run`.",
    Code.UNPLACED: "Put the robot on its start pose and restart its bring-up, then `run`. If its odometry"
    " has gone on counting since it stood there, only `run`.",
    Code.AGENT_FAILS: "Read the agent's log (`journalctl -u formation-agent`). Check the robot, its place and"
    " its sensors: the next agent may know of no doubt that this one had. Then `run`.",
    Code.STOP_UNKNOWN: "The file of saved stops cannot be read. `release` the robot if it may drive.",
    Code.NO_ORDER: f"{WAIT} check that the leader runs and that a path of neighbours leads to it.",
    Code.ORDER_UNSIGNED: "Check the leader's certificate, and that no other process gives orders.",
    Code.LEADER_LOST: "Check the leader's process and the network. It goes on when orders come again.",
    Code.STOPPED_BY_LEADER: "`formation order MISSION release`, then `run`.",
    Code.HELD_BY_LEADER: "`formation order MISSION run`; if the leader refuses, read its reason.",
    Code.COMMAND_NOT_FINITE: "Correct a law of your own; else report it as a defect, with the recording.",
    Code.NO_LINK: "Start the robot's bridge or router; check `robot_endpoint`.",
    Code.NO_LISTENER: "Restart the robot's bring-up together with its bridge or router.",
    Code.SECOND_AGENT: "End one of the two agents.",
    Code.PROCESS_FROZEN: "Nothing; it goes on by itself when what it waits for comes. If it recurs, check the"
    " machine's load.",
    Code.OUTSIDE_BOUNDS: "Bring the robot back inside, or widen `[bounds]`.",
    Code.RUNNING: "Nothing.",
    Code.NO_POSITION: f"{WAIT} check what publishes odometry or the external pose.",
    Code.POSITION_SILENT: "Check what publishes odometry or external pose, and the link to the robot.",
    Code.POSITION_REFUSED: "See to what it names: orientation, unit, or the clock of what publishes it.",
    Code.POSITION_LATE: "Check what publishes the position, the machine's load, and the clocks (chrony).",
    Code.POSITION_WAS_LATE: "Nothing; it goes on by itself when positions stay in time.",
    Code.NOT_LOCALISED: "Give the localiser an initial pose (RViz: 2D Pose Estimate), and see that its "
    "messages reach the agent.",
    Code.LOCALISER_SILENT: "See that the localiser runs, that `amcl_pose` or `tf` reaches the agent, and that"
    " the robot is where it says.",
    Code.LOCALISER_JUMPS: "Check the map and the scanner; then order `hold` and `run`.",
    Code.LOCALISER_CONTRADICTS: "Check the initial pose, that the localiser's base frame is odometry's, and"
    " that no other process publishes `amcl_pose` or `tf`; then order `hold` and `run`.",
    Code.LOCALISER_REFUSED: "See to what it names: clocks, the frame, or an uncertain pose.",
    Code.RELOCALISED: "Nothing: the robot goes on at its new position.",
    Code.POSITION_JUMPED: "Nothing for a single jump. If it recurs, check odometry or tracking.",
    Code.HEADING_JUMPED: "Nothing for a single jump. If it recurs, check odometry or tracking.",
    Code.POSITION_TOO_FAR: "Check what publishes the position: its unit must be metres.",
    Code.HEADING_CONTRADICTED: "Check how the marker or sensor is mounted on the robot, and that no motors"
    " are swapped. Then `hold`, and `run`.",
    Code.PATH_MIRRORED: "Check that the frame of the poses is right-handed, that the marker is this robot's,"
    " and that no motors are swapped. Then `hold`, and `run`.",
    Code.POSITION_GAP: "Nothing for a single gap. If it recurs, check that the position comes at `rate`.",
    Code.NO_SCAN: f"{WAIT} check the scanner's driver.",
    Code.SCAN_SILENT: "Check the scanner and its driver.",
    Code.SCAN_REFUSED: "See to what it names: the stamp, or the clock of the scanner's computer (chrony).",
    Code.SCAN_LATE: f"{CLOCKS} Check the load of the scanner's driver.",
    Code.SCAN_EARLY: CLOCKS,
    Code.SCAN_BLIND: "Use a scanner that sees closer, or correct its driver: `range_min` is too large.",
    Code.SCAN_SHORT: "Use a scanner that sees further or scans more often, or lower `max_speed`.",
    Code.SCAN_SECTOR: "Correct `yaw_deg`; state the scanner's `model`, as some drivers leave out beams;"
    " or use a scanner that sees ahead.",
    Code.SCAN_EMPTY: "Check that the scanner turns and is not covered. It goes on by itself when a"
    " beam comes back.",
    Code.SCAN_UNPLACED: "Check the speeds that the odometry reports.",
    Code.SCAN_FROZEN: "Check the scanner and its driver. It goes on by itself when scans change.",
    Code.RELATIVE_LATE: "Check what measures neighbours, the machine's load, and the clocks (chrony).",
    Code.RELATIVE_WAS_LATE: "Nothing; it goes on by itself when displacements come in time.",
    Code.RELATIVE_CONTRADICTED: "If neither robot was carried or pushed, check the sensor's axes and"
    " mounting, and that it knows neighbours apart. Then `hold`, and `run`.",
    Code.RELATIVE_FROZEN: "Check what measures neighbours, and the wheels. It goes on when displacements"
    " change; `hold`, then `run` makes it try again.",
    Code.SIGHT_SEARCHING: "Clear the view between the robots; compare `seen`, `scan` and start poses with"
    " the robots. It goes on by itself when it is locked.",
    Code.SIGHT_PLACING: "Nothing; it goes on by itself. Was the robot on its start pose?",
    Code.SIGHT_CONTRADICTED: "Put the robot back in its place, its start pose if it has not driven; or"
    " clear the view; else correct `yaw_deg`, or which scanner's topic comes. It goes on by itself when it is"
    " locked.",
    Code.SIGHT_UNRELIABLE: "Check that odometry's heading agrees with the way it drives, the wheels,"
    " `scan` of the mission, and which scanner's topic comes; put it back in its place; then order `hold` and"
    " `run`.",
    Code.SIGHT_LOST: "Clear the view between the robots. It goes on when it sees one of them.",
    Code.MOTION_FROZEN: SENSORS,
    Code.MOTION_TURN: SENSORS,
    Code.MOTION_SPEEDS: "Check the speeds that the odometry reports.",
    Code.MOTION_CARRIED: HAND,
    Code.MOTION_TURNED: HAND,
    Code.MOTION_LATE: "Have the driver stamp when it measures, and find what delays it.",
    Code.PROBE_BLOCKED: "Move the robot away from what it stands beside, then `hold` and `run`.",
    Code.OTHER_MISSION: MISSIONS,
    Code.UNKNOWN_MISSION: MISSIONS,
    Code.UNANSWERED: "Check the network between the robots, and the clocks (chrony).",
    Code.NO_NEIGHBOUR: "Check the neighbours that it names; give the robot `fallback_neighbours`.",
    Code.ROUTE_UNKNOWN: "Order a speed or a route, then `run`.",
    Code.ORDER_UNREAD: "Check the certificates of the leader and its clock; then order `run`.",
    Code.NO_ROBOT: "Start the robots; check the links of the leader's machine.",
    Code.STOPPED_AT_BOUNDS: "Order a speed or a route that leads back inside.",
    Code.WAITS: "Check the robots that it names; `patience` in `[cohesion]` limits the wait.",
    Code.ROUTE_ENDED: "Nothing, or order a speed or a route.",
    Code.NOT_DRIVEN: "Drive it by hand (`formation drive`), or order a speed or a route.",
    Code.OTHER_LEADS: "Nothing.",
    Code.NO_LEADER: "Wait for one takeover. If it stays, check that over half of the followers run.",
    Code.TERM_AHEAD: "Set the clock of the leader's machine (`chronyc tracking`).",
    Code.TERM_EARLIER: "Nothing; a later leader is in force, or has been. If it stays, check the clocks.",
}
"""What to do, for people."""
