"""Simulation of labelled recordings: an object moves in contact with fixed surroundings.

Kinematic and seeded; constraints hold exactly before measurement noise is added. No input or output.
"""

from contact_tracker_lab.simulate.scenarios import SCENARIOS, Phase, Scenario, named_scenario
from contact_tracker_lab.simulate.simulator import Simulated, simulate

__all__ = ["SCENARIOS", "Phase", "Scenario", "Simulated", "named_scenario", "simulate"]
