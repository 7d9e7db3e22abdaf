"""Plants: what a controller's commands move."""

from coopqp.simulation.plants.kinematic import KinematicPlant, Plant

__all__ = ["KinematicPlant", "Plant"]
