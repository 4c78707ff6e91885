"""Scenario files: their typed schema, the ready ones, and the records made from them."""

from deepgnss.sim.schema.build import Simulation, build
from deepgnss.sim.schema.document import REFERENCE_HEAD, ScenarioConfig
from deepgnss.sim.schema.ready import PUBLISHED, Ready, load_scenario, ready_scenarios

__all__ = [
    "PUBLISHED",
    "REFERENCE_HEAD",
    "Ready",
    "ScenarioConfig",
    "Simulation",
    "build",
    "load_scenario",
    "ready_scenarios",
]
