"""Labelled recordings of an object that is moved in contact with fixed surroundings, from a seed.

Kinematic: the contact constraint holds exactly before the sensor's noise is added. No input or output.
"""

from contact_tracker.simulate.scenarios import SCENARIOS, Phase, Scenario, named_scenario
from contact_tracker.simulate.simulator import Simulated, simulate

__all__ = ["SCENARIOS", "Phase", "Scenario", "Simulated", "named_scenario", "simulate"]
