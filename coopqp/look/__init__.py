"""Visualisation: plots, timeline, renderer, viewer, report.

Import public names from here or from :mod:`coopqp`. Drawing needs ``coopqp[plot]``, the viewer ``coopqp[viewer]``.
"""

from typing import TYPE_CHECKING

from coopqp.lazy import lazy_names

if TYPE_CHECKING:
    from coopqp.look.calibration import calibration_figure, write_calibration
    from coopqp.look.joints import joint_figure
    from coopqp.look.loads import load_figure, run_loads_figure, write_load_use
    from coopqp.look.placements import placement_figure
    from coopqp.look.plots import error_figure, motion_figure
    from coopqp.look.profile import profile_figure, write_speed_profile
    from coopqp.look.renderer import Solid, View, box_solid, cell_solids, render
    from coopqp.look.report import write_report
    from coopqp.look.style import save_figure
    from coopqp.look.sweeps import sweep_figure
    from coopqp.look.viewer import LiveViewer, export_html
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "coopqp.look.joints": "joint_figure",
            "coopqp.look.plots": "error_figure motion_figure",
            "coopqp.look.calibration": "calibration_figure write_calibration",
            "coopqp.look.loads": "load_figure run_loads_figure write_load_use",
            "coopqp.look.profile": "profile_figure write_speed_profile",
            "coopqp.look.renderer": "Solid View box_solid cell_solids render",
            "coopqp.look.report": "write_report",
            "coopqp.look.style": "save_figure",
            "coopqp.look.placements": "placement_figure",
            "coopqp.look.sweeps": "sweep_figure",
            "coopqp.look.viewer": "LiveViewer export_html",
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
