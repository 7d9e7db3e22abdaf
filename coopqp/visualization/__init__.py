"""Visualisation: plots, timeline, renderer, viewer, report.

Import public names from here or from :mod:`coopqp`. Drawing needs ``coopqp[plot]``, the viewer ``coopqp[viewer]``.
"""

from typing import TYPE_CHECKING

from coopqp.lazy import lazy_names

if TYPE_CHECKING:
    from coopqp.visualization.calibration import calibration_figure, write_calibration
    from coopqp.visualization.joints import joint_figure
    from coopqp.visualization.loads import load_figure, run_loads_figure, write_load_use
    from coopqp.visualization.placements import placement_figure
    from coopqp.visualization.plots import error_figure, motion_figure
    from coopqp.visualization.profile import profile_figure, write_speed_profile
    from coopqp.visualization.renderer import Solid, View, box_solid, cell_solids, render
    from coopqp.visualization.report import write_report
    from coopqp.visualization.style import save_figure
    from coopqp.visualization.sweeps import sweep_figure
    from coopqp.visualization.viewer import LiveViewer, export_html
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "coopqp.visualization.joints": "joint_figure",
            "coopqp.visualization.plots": "error_figure motion_figure",
            "coopqp.visualization.calibration": "calibration_figure write_calibration",
            "coopqp.visualization.loads": "load_figure run_loads_figure write_load_use",
            "coopqp.visualization.profile": "profile_figure write_speed_profile",
            "coopqp.visualization.renderer": "Solid View box_solid cell_solids render",
            "coopqp.visualization.report": "write_report",
            "coopqp.visualization.style": "save_figure",
            "coopqp.visualization.placements": "placement_figure",
            "coopqp.visualization.sweeps": "sweep_figure",
            "coopqp.visualization.viewer": "LiveViewer export_html",
        },
    )

__all__ = [
    "LiveViewer",
    "Solid",
    "View",
    "box_solid",
    "calibration_figure",
    "cell_solids",
    "error_figure",
    "export_html",
    "joint_figure",
    "load_figure",
    "motion_figure",
    "placement_figure",
    "profile_figure",
    "render",
    "run_loads_figure",
    "save_figure",
    "sweep_figure",
    "write_calibration",
    "write_load_use",
    "write_report",
    "write_speed_profile",
]
