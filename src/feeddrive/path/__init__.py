"""Planning of motions: from a part program to setpoints."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "program.blocks": "read_offsets Line",
        "program.moves": (
            "Command canonical_text Arc Dwell End Feed Ignored Message Move Offsets PathMode Point Probe Spindle "
            "Spline Stop Straight Switch Synchronized ToolChange Wait"
        ),
        "program.reading": "read_commands read_program",
        "program.state": "Tool read_tools",
        "kinematics": "Branches Kinematics RotaryJoint UnreachableError",
        "five_axes": "HeadHead HeadTable TableTable",
        "orientation": (
            "Orientations choose_rotary interpolate_axes interpolate_plane interpolate_vector leaves_arc unwound"
        ),
        "limits": "AxisLimits MachineLimits",
        "planned": "Planned planned_of",
        "setpoints": "Setpoints",
        "polygon": "waypoints",
    },
)
