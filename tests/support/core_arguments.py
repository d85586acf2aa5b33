"""Arguments of satellites that bsk_rl lacks."""

SPACECRAFT = {
    *("compensateWheels", "integralLimit", "knownTorquePntB_B"),
    *("thrusters", "thrusterPositions_B", "thrusterDirections_B", "thrusterMaxThrust"),
    *("faults", "rwAvailable"),
    "instruments",
    "earthRotation",
    *("imageTargetMinimumSunElevation", "imageTargetMaximumSunElevation", "imageTargetVertical"),
    *("panels", "panelNormals_B", "panelRates", "panelAngles"),
    *("facets", "facetAreas", "facetNormals_B", "facetPositions_B"),
    *("inertia", "checkInertia", "r_CB_B", "wheels", "nullSpaceGain", "nullSpaceSpeeds", "underactuated"),
    *("rwAxes_B", "rwJs", "rwOmegaMax", "rwUMin", "rwPMax", "rwFCoulomb", "rwFStatic", "rwBetaStatic", "rwCViscous"),
}
"""What bsk_rl's users change in the code of their dynamics and flight-software models."""
