"""The grid of times on which arcs are solved and kept."""

from __future__ import annotations

from bsk_torch.sim.environment.ephemeris import RECORD_SPACING

NODE_SPACING = 60.0  # seconds between the nodes of an arc

ARC_SEGMENT = RECORD_SPACING
"""Seconds solved at once, by which arcs grow and move on, together with the records of the ephemeris."""

NODES_PER_SEGMENT = round(ARC_SEGMENT / NODE_SPACING)

LEAD_NODES = 4  # flown nodes before the beginning of an arc, so that interpolating polynomials are not one-sided there
PLAN_STEP = 30.0  # step, s, of the look-ahead propagation, whose samples are those of the planned arc
RECORDS = 3  # records of the ephemeris in which a segment lies, with one more behind it

SAMPLES_PER_SEGMENT = round(ARC_SEGMENT / PLAN_STEP)
