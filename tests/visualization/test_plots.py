"""The pictures show the data of the recordings."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from marks import slow_unless
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text
from odd_cells import joints_that_move_no_tool
from runs import of_the_paper

from coopqp import Arm, InvalidInputError, Recording, RobotCell, simulate
from coopqp.errors import MissingExtraError, OutputError
from coopqp.scenarios import Scenario, paper_lift
from coopqp.visualization import plots, style
from coopqp.visualization.joints import joint_figure


@pytest.fixture(scope="module")
def lift() -> Scenario:
    return paper_lift()


def run(lift: Scenario, steps: int, **options: str) -> Recording:
    return simulate(of_the_paper(lift, steps, **options), q_start=lift.q_start)


@pytest.fixture(scope="module")
def runs(lift: Scenario) -> dict[str, list[Recording]]:
    return {
        "euler": [run(lift, n) for n in (12, 24)],
        "midpoint": [run(lift, n, integration="midpoint") for n in (12, 24)],
    }


@pytest.fixture(scope="module")
def one(runs: dict[str, list[Recording]]) -> Recording:
    return runs["euler"][1]


@pytest.mark.parametrize("quantity", ["position", "orientation"])
def test_figure_5_has_a_curve_per_run_and_a_colour_per_number_of_steps(
    lift: Scenario, runs: dict[str, list[Recording]], quantity: plots.Quantity
) -> None:
    figure = plots.error_figure(lift.cell, runs, quantity=quantity)
    (axes,) = figure.axes
    assert axes.get_yscale() == "log"
    curves = axes.lines
    assert len(curves) == 4
    assert curves[0].get_color() == curves[2].get_color() != curves[1].get_color()
    assert curves[0].get_linestyle() == "-"
    assert curves[2].get_linestyle() == "--"
    expected = plots.relative_errors(lift.cell, runs["midpoint"][1], quantity)
    np.testing.assert_array_equal(curves[3].get_ydata(), expected[1:])
    assert {"euler", "midpoint"} < {text.get_text() for text in figure.legends[0].get_texts()}


def test_figure_5_takes_any_number_of_runs(lift: Scenario, one: Recording) -> None:
    recordings = [run(lift, n) for n in (2, 3, 4, 5)]
    assert len(plots.error_figure(lift.cell, {"a": recordings, "b": [one]}).axes[0].lines) == 5


def test_a_slowed_run_keeps_the_colour_of_its_number_of_steps(lift: Scenario, one: Recording) -> None:
    longer = np.append(one.time, one.time[-1] + 0.1)
    slowed = replace(
        one, time=longer, q_command=np.vstack([one.q_command, one.q_command[-1:]]), rate=np.append(one.rate, 0.0)
    )
    curves = plots.error_figure(lift.cell, {"full": [one], "slowed": [slowed]}).axes[0].lines
    assert slowed.n_steps == plots.planned_steps(slowed) + 1
    assert curves[0].get_color() == curves[1].get_color()


def test_figure_5_says_that_a_small_error_is_below_rounding_and_does_not_draw_it(
    lift: Scenario, one: Recording
) -> None:
    resting = replace(one, q_command=np.tile(lift.q_start, (one.n_steps + 1, 1)))
    figure = plots.error_figure(lift.cell, {"moving": [one], "resting": [resting]}, quantity="orientation")
    assert len(figure.axes[0].lines) == 1
    assert [text.get_text() for text in figure.legends[0].get_texts()][-1] == "N = 24: below 1e-9°"
    assert cut(figure) == []


def test_figure_5_without_a_run_is_refused(lift: Scenario) -> None:
    with pytest.raises(InvalidInputError, match="no recording"):
        plots.error_figure(lift.cell, {"a": []})


def test_figure_5_refuses_another_quantity(lift: Scenario, one: Recording) -> None:
    with pytest.raises(InvalidInputError, match="no quantity"):
        plots.error_figure(lift.cell, {"a": [one]}, quantity="force")  # type: ignore[arg-type]


def test_joints_are_drawn_in_shares_of_their_limits(lift: Scenario, one: Recording) -> None:
    figure = joint_figure(lift.cell, one)
    assert len(figure.axes) == 9  # positions above speeds above the names, three arms
    limits, joint = lift.cell.limits, 4  # the joint with asymmetric limits
    line = figure.axes[0].lines[joint]
    expected = 100.0 * (one.q_command[:, joint] - limits.lower[joint]) / (limits.upper[joint] - limits.lower[joint])
    np.testing.assert_allclose(line.get_ydata(), expected, atol=1e-10)
    assert [figure.axes[i].get_ylabel() for i in (0, 3)] == ["position [% of range]", "speed [% of limit]"]
    speed = figure.axes[3].lines[joint].get_ydata()
    np.testing.assert_allclose(speed[:-1], 100.0 * one.velocity[:, joint] / limits.velocity[joint])


def cut(figure: Any) -> list[str]:
    """Texts of a figure that are not wholly inside it."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    edge = figure.bbox.padded(1.0)
    hidden = {
        t for axes in figure.axes if not axes.axison for axis in (axes.xaxis, axes.yaxis) for t in axis.findobj(Text)
    }
    texts = [t for t in figure.findobj(Text) if t.get_text() and t.get_visible() and t not in hidden]
    texts = [t for t in texts if "mathdefault" not in t.get_text()]  # ticks, also those beyond the edge of the axes
    boxes = [(t.get_text(), t.get_window_extent(canvas.get_renderer())) for t in texts]
    return [text for text, box in boxes if box.width and not (edge.contains(*box.min) and edge.contains(*box.max))]


def still(cell: RobotCell, *, steps: int = 4) -> Recording:
    """A recording of arms that stay where they are."""
    q = np.tile(cell.configuration(np.zeros(cell.nv)), (steps + 1, 1))
    return Recording(
        time=np.arange(steps + 1.0),
        q=q,
        q_command=q,
        velocity=np.zeros((steps, cell.nv)),
        clock=np.arange(steps + 1.0),
        rate=np.ones(steps),
        status=np.zeros(steps, dtype=int),
        reference=np.tile(np.eye(4), (steps + 1, 1, 1)),
        T_object_tool=np.tile(np.eye(4), (len(cell), 1, 1)),
        notes=(),
        metadata={"finished": True},
    )


def renamed(arm: Arm, name: str, joint: str) -> Arm:
    """The arm with long names."""
    model = pin.Model(arm.model)
    for i in range(1, model.njoints):
        model.names[i] = f"{joint}_{i}"
    return Arm.from_model(name, model, tool_frame=arm.tool_frame, velocity_limits=1.0)


@pytest.mark.parametrize("arms", slow_unless(lambda arms: arms == 2, [1, 2, 3, 4, 7]))
def test_every_arm_has_its_own_joints_by_name_and_no_name_is_cut(
    mixed_cell: RobotCell, make_cell: Callable[..., RobotCell], arms: int
) -> None:
    robots = [*mixed_cell.arms, *make_cell(["rx90l"]).arms][:arms]
    long = renamed(robots[0], "the_arm_at_the_far_end_of_the_line_" * 2, "a_joint_with_a_name_of_some_length_" * 2)
    cell = RobotCell([*robots[1:], long])
    figure = joint_figure(cell, still(cell))
    legends = [legend for axes in figure.axes if (legend := axes.get_legend()) is not None]
    shown = {
        tuple(" ".join(text.get_text().split()).removesuffix(" (no limit)") for text in legend.get_texts())
        for legend in legends
    }
    own = [[name.split("/", 1)[1] for name in cell.joint_names[s]] for s in cell.v_slices]
    assert shown == {tuple(" ".join(name.replace("_", " ").split()) for name in names) for names in own}
    assert cut(figure) == []
    assert figure.get_figwidth() <= 10.0


def test_joints_that_move_no_tool_are_not_drawn(tmp_path: Path) -> None:
    cell = joints_that_move_no_tool(tmp_path)
    figure = joint_figure(cell, still(cell))
    names = [{text.get_text() for text in g.get_texts()} for axes in figure.axes if (g := axes.get_legend())]
    assert all(cell.nv == 14 and len(own) == 6 and all(name.startswith("j ") for name in own) for own in names)


@pytest.mark.slow
def test_many_arms_are_drawn_by_those_closest_to_a_limit(make_cell: Callable[..., RobotCell]) -> None:
    cell = make_cell(["arm7"] * 20)
    run = still(cell)
    q = run.q_command.copy()
    q[2, cell.position_index[cell.v_slices[13].start]] = 0.99 * cell.limits.upper[cell.v_slices[13].start]
    figure = joint_figure(cell, replace(run, q_command=q))
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert len(titles) == 12
    assert "13 arm7" in titles
    assert cut(figure) == []


@pytest.mark.slow
def test_joints_without_limits_leave_a_gap(lift: Scenario, one: Recording) -> None:
    cell = RobotCell([arm.with_limits(lower=-np.inf, upper=np.inf, velocity=np.inf) for arm in lift.cell.arms])
    figure = joint_figure(cell, one)
    style.figure_bytes(figure, dpi=40)
    assert all(np.isnan(line.get_ydata()[:-1]).all() for line in figure.axes[3].lines[:6])  # not 0 % of no limit
    (text, *_) = (t.get_text() for axes in figure.axes if (legend := axes.get_legend()) for t in legend.get_texts())
    assert " ".join(text.split()).endswith("(no limit, no speed limit)")


def test_the_lift_has_four_frames(lift: Scenario, one: Recording) -> None:
    figure = plots.motion_figure(
        lift.cell, one, object_size=lift.object_size, T_object_body=lift.T_object_body, pixels=120
    )
    labels = [axes.texts[-1 if i else 0].get_text() for i, axes in enumerate(figure.axes)]
    assert labels == ["t = 0.0 s", "t = 1.0 s", "t = 2.0 s", "t = 3.0 s"]
    assert {"master", "slave 1", "slave 2"} < {text.get_text() for text in figure.axes[0].texts}
    assert cut(figure) == []
    first, last = (np.asarray(figure.axes[i].images[0].get_array()) for i in (0, 3))
    assert (first != last).mean() > 0.05
    blue = (last[..., 2].astype(int) - last[..., 0] > 60).mean()  # the plate, tilted towards the viewer
    assert blue > (first[..., 2].astype(int) - first[..., 0] > 60).mean() > 0.02


def test_the_lift_refuses_no_frames(lift: Scenario, one: Recording) -> None:
    with pytest.raises(InvalidInputError, match="frames = 0"):
        plots.motion_figure(lift.cell, one, object_size=lift.object_size, T_object_body=lift.T_object_body, frames=0)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "start"), [("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")])
def test_figures_are_saved_by_their_ending(
    lift: Scenario, one: Recording, tmp_path: Path, kind: str, start: bytes
) -> None:
    figure = plots.error_figure(lift.cell, {"a": [one]})
    file = style.save_figure(figure, tmp_path / f"new/picture.{kind}", dpi=40)
    assert file.read_bytes().startswith(start)


def test_bad_destinations_are_named(lift: Scenario, one: Recording, tmp_path: Path) -> None:
    figure = plots.error_figure(lift.cell, {"a": [one]})
    with pytest.raises(InvalidInputError, match="no kind of picture"):
        style.save_figure(figure, tmp_path / "picture.xyz")
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="not a folder"):
        style.save_figure(figure, tmp_path / "file" / "picture.png", dpi=40)


def test_no_window_and_no_global_state(lift: Scenario, one: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)  # an import would fail
    style.figure_bytes(plots.error_figure(lift.cell, {"a": [one]}), dpi=40)


def test_a_missing_matplotlib_is_named(lift: Scenario, one: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=r"coopqp\[plot\]"):
        plots.error_figure(lift.cell, {"a": [one]})


def test_saving_is_repeatable(lift: Scenario, one: Recording) -> None:
    first, second = (style.figure_bytes(plots.error_figure(lift.cell, {"a": [one]}), dpi=40) for _ in range(2))
    assert first == second


NAMES = ("$x^{", "_\\frac$", "c")


def _texts(figure: Any) -> str:
    """All texts of a figure, drawn: Matplotlib raises where it takes a name for a formula that is none."""
    figure.set_layout_engine("none")  # it draws many times
    style.figure_bytes(figure, dpi=20)
    return "\n".join(text.get_text() for text in figure.findobj(Text))


@pytest.mark.slow
def test_names_are_text_and_no_formulas(lift: Scenario, one: Recording) -> None:
    from coopqp.forces import LoadShare, load_use
    from coopqp.planning import Payload
    from coopqp.simulation.evaluation.metrics import read_run
    from coopqp.visualization.calibration import calibration_figure
    from coopqp.visualization.loads import load_figure
    from coopqp.visualization.timeline import timeline_figure

    arms = [arm.with_tool(arm.tool_frame, name=name) for arm, name in zip(lift.cell.arms, NAMES, strict=True)]
    cell = RobotCell(arms)
    payload = Payload(mass=1.0, centre=lift.T_object_body.translation)
    use = load_use(LoadShare(cell, lift.grasp, payload, internal_force=50.0), [0, 1, 2], [lift.q_start] * 3)
    between = {"times_s": [0.0, 1.0], "distances_m": [0.1, 0.2], "time_s": 0.0, "closest_m": 0.1, "avoided": True,
               "margin_m": 0.01, "between": NAMES[:2]}  # fmt: skip
    run = replace(one, metadata={**one.metadata, "clearance": between})
    spread = dict.fromkeys(("base", "base_deviation", "grip", "grip_deviation"), np.ones(6))
    found = SimpleNamespace(
        before=np.ones((2, 2)), after=np.ones((2, 2)), samples=np.arange(2),
        corrections=[SimpleNamespace(arm=name, significant=True, **spread) for name in NAMES],
    )  # fmt: skip
    for figure in (
        joint_figure(cell, still(cell)), load_figure(use), timeline_figure(run, read_run(lift.cell, one)),
        plots.error_figure(lift.cell, {name: [one] for name in NAMES[:2]}), calibration_figure(found),  # type: ignore[arg-type]
    ):  # fmt: skip
        said = _texts(figure)
        assert r"\$x^{" in said
        assert r"\frac\$" in said


@pytest.mark.slow
def test_the_load_is_drawn_with_its_limits_and_where_it_is_too_heavy(lift: Scenario, tmp_path: Path) -> None:
    from coopqp.forces import Grip, LoadShare, load_use
    from coopqp.planning import Payload
    from coopqp.visualization import write_load_use
    from coopqp.visualization.loads import load_figure

    q = [lift.q_start] * 3
    for mass, grips, panels in ((20.0, None, 1), (90.0, [Grip(force=1e3)] * 3, 3)):
        payload = Payload(mass=mass, centre=lift.T_object_body.translation)
        use = load_use(LoadShare(lift.cell, lift.grasp, payload, internal_force=50.0, grips=grips), [0, 1, 2], q)
        figure = load_figure(use)
        assert len(figure.axes) == panels
        joints = figure.axes[0].get_lines()[: len(lift.cell)]
        for k, line in enumerate(joints):
            np.testing.assert_allclose(line.get_ydata(), 100.0 * use.joint[:, lift.cell.v_slices[k]].max(axis=1))
        assert ("Too heavy" in figure.axes[0].get_title(loc="left")) == (mass == 90.0)
    assert write_load_use(use, tmp_path / "load.png", dpi=50).stat().st_size > 5_000
