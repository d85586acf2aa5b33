"""Wheels, thrusters and torque bars."""
