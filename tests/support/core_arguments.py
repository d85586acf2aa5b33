"""Arguments that the core has in addition to those of bsk_rl."""

SPACECRAFT = frozenset(
    (
        "checkInertia",
        "compensateWheels",
        "inertia",
        "integralLimit",
        "knownTorquePntB_B",
        "nullSpaceGain",
        "nullSpaceSpeeds",
        "r_CB_B",
        "rwAxes_B",
        "rwBetaStatic",
        "rwCViscous",
        "rwFCoulomb",
        "rwFStatic",
        "rwJs",
        "rwOmegaMax",
        "rwPMax",
        "rwUMin",
        "thrusterDirections_B",
        "thrusterMaxThrust",
        "thrusterPositions_B",
        "thrusters",
        "underactuated",
        "wheels",
    )
)
"""Arguments of bodies, wheels, thrusters and control laws."""
