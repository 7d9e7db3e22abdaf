from .calibration import calibration_figure as calibration_figure, write_calibration as write_calibration
from .jog.link import PageLink as PageLink
from .joints import joint_figure as joint_figure
from .loads import load_figure as load_figure, run_loads_figure as run_loads_figure, write_load_use as write_load_use
from .placements import placement_figure as placement_figure
from .plots import error_figure as error_figure, motion_figure as motion_figure
from .profile import profile_figure as profile_figure, write_speed_profile as write_speed_profile
from .renderer import Solid as Solid, View as View, box_solid as box_solid, cell_solids as cell_solids, render as render
from .report import write_report as write_report
from .route_page import export_route as export_route
from .route_plots import route_figure as route_figure
from .style import save_figure as save_figure
from .sweeps import sweep_figure as sweep_figure
from .viewer import LiveViewer as LiveViewer, export_html as export_html
