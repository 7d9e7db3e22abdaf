"""Columns of the table of a study."""

from __future__ import annotations

from collections.abc import Mapping

#: Columns of a run's figures, and their meaning.
FIGURES: Mapping[str, str] = {
    "time_s": "time that the run took [s]",
    "steps": "number of steps",
    "rate_min": "smallest rate of the object's clock",
    "eps_p_mm": "largest ε_p of the commands [mm]",
    "eps_o_deg": "largest ε_o of the commands [deg]",
    "chain_mm": "largest distance between the object poses of any two arms, as commanded [mm]",
    "chain_deg": "the same as an angle [deg]",
    "true_chain_mm": "the same, as the disturbed arms really stand [mm]",
    "true_chain_deg": "the same as an angle [deg]",
    "object_mm": "largest distance of the object from its path, as measured [mm]",
    "object_deg": "the same as an angle [deg]",
    "object_end_mm": "distance of the object from its path at the end [mm]",
    "sigma_min": "smallest singular value of any arm's tool Jacobian",
    "margin_deg": "least distance of a turning joint from its position limits [deg]",
    "margin_mm": "least distance of a sliding joint from its position limits [mm]",
    "speed_share": "largest joint speed, as a share of its limit",
    "unrest_deg_per_s": "change of turning joints' commanded speeds from step to step, rms [deg/s]",
    "closest_mm": "least distance of bodies, where the task has bodies that keep distances [mm]",
}
#: Columns before the figures.
OUTCOMES = ("outcome", "reason", "status", "finished", "verdict")
OK, FAILED, LOST = "ok", "failed", "lost"
