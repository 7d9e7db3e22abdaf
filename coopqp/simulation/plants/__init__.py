"""Plants: the simulated or replayed arms that execute a controller's commands."""

from coopqp.simulation.plants.kinematic import KinematicPlant, Plant

__all__ = ["KinematicPlant", "Plant"]
