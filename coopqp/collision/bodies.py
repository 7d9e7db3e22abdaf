"""Shapes and bodies, as users give them: names of :mod:`coopqp.model.shapes`."""

from coopqp.model.shapes import Body, Box, Capsule, Cylinder, Hull, Mesh, NearPair, Sphere

__all__ = ["Body", "Box", "Capsule", "Cylinder", "Hull", "Mesh", "NearPair", "Sphere"]
