"""The path ahead of the object's clock: where limits and singularities bind, and how fast the object may go.

Under acceleration limits no single step can keep both the chain and the path at a limit: all arms have to brake
together, ahead of it. The preview runs the chain's own inverse kinematics ahead of the clock, cell by cell, and
stores the joints' derivatives with respect to the clock, ``q′ = A⁻¹ν`` and ``q″``. With rate σ the joints move at
``q′σ`` and accelerate at ``q′σ̇ + q″σ²``, so each cell bounds ``z = σ²`` and its decrease per clock second:

    z_cap = min(1, (η v_j / |q′_j|)², κ η a_j / |q″_j|),   D = min(0.9 σ̇_max, (η a_j − |q″_j| z_cap) / |q′_j|)

and the rate at clock τ may be what still brakes to every bound ahead, ``S(τ) = min_b [z_b + 2∫_τ^b D]``. It is path
timing on a rolling horizon: as long as the object needs to stop, and no longer.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coopqp.checks import as_count, keep_scalars
from coopqp.control.core import BorderArrays, NumpyKernel, Outcome, Workspace, make_border, make_kernel
from coopqp.control.limits import VelocityBox
from coopqp.model.cell import JointLimits
from coopqp.model.chain import Chain
from coopqp.model.inverse_kinematics import newton
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.spatial import Array
from coopqp.task.path import ObjectPath
from coopqp.task.posture import Posture


@dataclass(frozen=True, kw_only=True)
class PreviewOptions:
    """Settings of the preview.

    Attributes:
        cell: longest cell [s of the clock].
        joint_step: largest joint motion in a cell [rad or m].
        slope_step: largest change of a joint's slope in a cell, as a share of the largest slope and of its speed.
        shortest: cells are not halved below this [s].
        margin: η, share of velocity and acceleration limits that is planned with where acceleration is limited.
        curvature_share: κ, share of the acceleration that the path's curvature may take.
        rate_slope: σ̇_max, largest change of the rate [1/s], where acceleration is limited.
        singular_rate: a rate cap below this, while joint speeds still rise, ends the path there, unless they fall
            again before it is below 0.3 of this.
        newton_steps: so many of the chain's Newton steps may be taken in one control step. Where that is too little to
            see as far as the object needs to stop, it slows down.
    """

    cell: float = 0.02
    joint_step: float = 0.02
    slope_step: float = 0.1
    shortest: float = 1e-6
    margin: float = 0.95
    curvature_share: float = 0.5
    rate_slope: float = 10.0
    singular_rate: float = 1e-2
    newton_steps: int = 60

    def __post_init__(self) -> None:
        keep_scalars(self, "cell", "joint_step", "slope_step", "shortest", "rate_slope")
        keep_scalars(self, "margin", "curvature_share", "singular_rate", high=1.0)
        object.__setattr__(self, "newton_steps", as_count(self.newton_steps, "PreviewOptions: newton_steps"))

    def slope(self, *, accelerates: bool, dt: float) -> float:
        """Largest change of the rate [1/s] of joints with or without acceleration limits."""
        return self.rate_slope if accelerates else 1.0 / (_STEPS_TO_FULL_SPEED * dt)


class _Cell(NamedTuple):
    """The border of a cell: the chain at one clock."""

    clock: float
    q: Array
    slope: Array  # q′ (nv,)
    cap: float  # z_b: largest σ² here
    squeeze: float  # what the limits alone would make of the cap
    cumulative: float  # C = 2 ∫ D up to here
    decrease: float  # D in the cell that ends here
    curvature: Array  # q″ in the cell that ends here
    binding: BindingLimit | None  # what makes the cap
    fastest: float  # largest |q′|
    change: float  # largest change of a slope in the cell that ends here, less what is always allowed
    inside: bool  # all joints are inside their position limits


#: A joint without acceleration limit is planned to reach full speed in this many steps, and so is the rate.
_STEPS_TO_FULL_SPEED = 22
#: A singularity is passed where the rate's cap stays above this share of the one that ends the path.
_PASSABLE = 0.3
#: Cells shorter than this are not halved for a change of slope [s].
_FINE_CELL = 0.001
#: Refinements of the rate near a bound.
_BISECTIONS = 6
#: The twist before a corner or the end is that so much earlier [s].
_JUST_BEFORE = 1e-10
#: Of squares of rates, which are differences of sums.
_ROUNDING = 1e-12
#: A cell is begun so many steps before it is needed.
_STEPS_TO_GROW = 8
_UNBOUND = _Cell(np.inf, np.zeros(0), np.zeros(0), 0.0, 0.0, 0.0, 0.0, np.zeros(0), None, 0.0, 0.0, True)
_OPEN = _UNBOUND._replace(cap=np.inf)
#: Newton steps that a reset may take, and cells that a way past a singularity may have.
_NEWTON_STEPS_AT_START, _LONGEST_WAY = 1000, 300
#: Arms with few joints can follow a path if no more than this is left where Newton's method ends [m, rad].
_FOLLOWED = 1e-4
#: Newton steps shorter than this are the last: the next would be of the square of it [rad or m].
_CONVERGED = 1e-5


class PathPreview:
    """Rolling preview of one path for one chain.

    Args:
        chain: a workspace; what it held is overwritten.
        path: the object's path.
        posture: what redundant arms do with their freedom.
        dt: nominal length of a control step [s].
        options: settings.

    Attributes:
        ends: what makes the latest cap stops the object for good.
        blind: arms with fewer than six joints cannot follow the path; nothing is known ahead.
    """

    def __init__(
        self,
        chain: Chain,
        path: ObjectPath,
        posture: Posture,
        *,
        dt: float,
        options: PreviewOptions | None = None,
        kernel: str = "auto",
    ) -> None:
        self._chain, self._path, self._posture, self._dt = chain, path, posture, dt
        self.options = options or PreviewOptions()
        limits = chain.cell.limits
        # The kernel's step with unit gains and without limits is one Newton step of the chain's inverse kinematics,
        # and what a unit of rate contributes is q′.
        n = chain.nv
        free = JointLimits(np.full(n, -np.inf), np.full(n, np.inf), np.full(n, np.inf), np.full(n, np.inf))
        shares = np.full((chain.n_arms, 6), 1.0 / chain.n_arms)
        ws = self._ws = Workspace(chain, shares, VelocityBox(chain.cell, free), wants_along=True)
        ws.scalars[[ws.DT, ws.GRASP_GAIN, ws.PATH_GAIN, ws.LAST_DT]] = 1.0
        ws.scalars[[ws.SPEED, ws.SPIN]] = np.inf
        kernel = "numpy" if chain.deficient else "auto" if kernel == "none" else kernel
        self._kernel = make_kernel(ws, kernel) or NumpyKernel(ws)
        self._low, self._high = limits.lower, limits.upper
        finite = np.isfinite(limits.acceleration)
        self.accelerates = bool(finite.any())
        self._speed = np.where(finite, self.options.margin, 1.0) * limits.velocity
        # A joint without acceleration limit may still not change its velocity so fast that a step's linearisation
        # fails: it is planned with a change of full speed in a number of steps, and without speed cap, which the
        # step itself finds. A jump of velocity (a corner, the path's end) is its own business.
        speed = np.where(np.isfinite(limits.velocity), limits.velocity, 1.0)
        self._cell = chain.cell
        swift = speed / (_STEPS_TO_FULL_SPEED * dt)
        self._acceleration = np.where(finite, self.options.margin * limits.acceleration, swift)
        self._jump = np.where(finite, self.options.margin * limits.acceleration, np.inf) * dt
        self._border = BorderArrays(
            ws.along_velocity,
            limits,
            per_speed=1.0 / self._speed,
            per_bend=1.0 / (self.options.curvature_share * self._acceleration),
            acceleration=self._acceleration,
            slope_change=self.options.slope_step * speed,
            caps_speed=self.accelerates,  # else the step itself finds that cap
        )
        self._evaluate = make_border(self._border, self._kernel.name).evaluate
        self._slope_cap = self.options.slope(accelerates=self.accelerates, dt=dt)
        if self.accelerates:
            self._slope_cap *= 0.9
        self._line: Array | None = None
        self._cells: deque[_Cell] = deque()
        self._bounds: deque[_Cell] = deque()  # candidates for min (z_b + C_b), increasing
        self._complete = self.ends = self.blind = False
        self._forget()

    def _forget(self) -> None:
        """Nothing is known of when the next cell will be needed, and none is begun."""
        self._free_until, self._begin_at = -np.inf, np.inf
        self._growing: Iterator[None] | None = None

    def reset(self, q: Array, clock: float) -> None:
        """Start at a configuration on (or near) the path, and look ahead as far as the first step needs."""
        self._cells.clear()
        self._bounds.clear()
        self._complete = self.ends = self.blind = False
        self._forget()
        pose = self._path.pose(clock)
        q, errors = newton(self._chain, pose, q, tolerance=1e-10, max_iter=8)
        self.blind = self._beyond_few_joints(errors)
        if not np.abs(errors).max() < 1e-6 and not self.blind:
            arm = int(np.abs(errors).max(axis=1).argmax())
            self._ws.along_velocity[:] = 0.0
            blocked = self._cell_at(clock, q, None)
            self._push(blocked._replace(cap=0.0, binding=self._arm_limit(arm, LimitKind.REACH)))
            self._complete = True
            return
        self._newton_step(clock, q, after=True)
        self._push(self._cell_at(clock, q, None))
        self._extend(clock, self._dt, _NEWTON_STEPS_AT_START)

    # -- reading -------------------------------------------------------------------------------------------------

    def cap(self, clock: float, dt: float) -> tuple[float, BindingLimit | None]:
        """Largest admissible rate σ at ``clock`` for a step of ``dt``, and what ahead makes it less than 1."""
        if self.blind:
            return 1.0, None
        if clock < self._free_until and dt <= self._dt:
            if clock >= self._begin_at:
                self._work_ahead()
            return 1.0, None
        self._extend(clock, dt, self.options.newton_steps)
        if not self._complete and not self._reaches(clock + _STEPS_TO_GROW * dt, dt):
            self._work_ahead()
        here = self._cells[0]
        self.ends = False
        while self._bounds and self._bounds[0].clock <= clock and (len(self._bounds) > 1 or self._bounds[0].cap > 0.0):
            self._bounds.popleft()
        ahead = self._cells[1] if len(self._cells) > 1 else here
        D = ahead.decrease
        C = here.cumulative + 2.0 * D * (clock - here.clock)
        square, bound = self._square(C)
        between = _between(here, ahead, clock)
        step = D * dt
        if between >= 1.0 and square >= 1.0 + 2.0 * step:  # −D dt + √((D dt)² + S) ≥ 1
            if not self._bounds:
                self._free_until = self._enough_until()
                self._begin_at = self._free_until - _STEPS_TO_GROW * self._dt if self._free_until < np.inf else np.inf
            return 1.0, None
        fall = 2.0 * D  # of S, per clock second
        if between < square:
            square, bound = between, here if here.cap < ahead.cap else ahead
            fall = max(here.cap - ahead.cap, 0.0) / (ahead.clock - here.clock) if ahead.clock > here.clock else 0.0
        self.ends = bound.cap == 0.0 and bound is not _UNBOUND
        # S falls while the object goes: σ² = S − fall σ dt while it goes on as it begins, or what there is on arrival.
        half = 0.5 * fall * dt
        root = math.sqrt(half * half + square)
        rate = min(square / (half + root) if root > 0.0 else 0.0, 1.0)
        fast = min(math.sqrt(square), 1.0)
        fast = min(fast, math.sqrt(self._square_at(clock + fast * dt)))
        for candidate in (max(rate, fast), min(rate, fast)):
            if self._admits(candidate, clock + candidate * dt):
                return candidate, bound.binding
        low, high = 0.0, min(rate, fast)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            if self._admits(middle, clock + middle * dt):
                low = middle
            else:
                high = middle
        return low, bound.binding

    def _square(self, cumulative: float) -> tuple[float, _Cell]:
        """S where C has a value: the least of z_b + C_b ahead, less C, and the cell that makes it."""
        last = self._cells[-1]
        bound = self._bounds[0] if self._bounds else _OPEN
        square = bound.cap + bound.cumulative - cumulative
        if not self._complete and last.cumulative - cumulative < square:
            return max(last.cumulative - cumulative, 0.0), _UNBOUND
        return max(square, 0.0), bound

    def _enough_until(self) -> float:
        """Clock until which the known horizon lets the object go on at full rate."""
        cells = self._cells
        if self._complete:
            return np.inf
        enough = cells[-1].cumulative - 1.0 - 2.0 * self._slope_cap * self._dt
        latest = cells[-1].clock - 2.0 * self._dt
        # The last border up to which there is enough; a cell's own decrease counts for the one that begins there.
        return next((c.clock for c in reversed(cells) if c.cumulative < enough and c.clock <= latest), -np.inf)

    def _cell_of(self, clock: float) -> int:
        """Number of the border that the cell of ``clock`` begins with."""
        cells = self._cells
        i = 0
        while i + 1 < len(cells) and cells[i + 1].clock <= clock:
            i += 1
        return i

    def _square_at(self, clock: float) -> float:
        """S at a clock ahead."""
        cells, i = self._cells, self._cell_of(clock)
        here = cells[i]
        if i + 1 == len(cells):
            return max(here.cap, 0.0) if self._complete else 0.0
        ahead = cells[i + 1]
        C = here.cumulative + 2.0 * ahead.decrease * (clock - here.clock)
        square = _between(here, ahead, clock)
        if not self._complete:
            square = min(square, cells[-1].cumulative - C)
        for bound in self._bounds:
            if bound.clock > clock:
                square = min(square, bound.cap + bound.cumulative - C)
        return max(square, 0.0)

    def _admits(self, rate: float, clock: float) -> bool:
        """Whether the object may arrive at ``clock`` with ``rate``."""
        square = rate * rate
        return square <= self._square_at(clock) + _ROUNDING and all(
            self._cells[m].cap + _ROUNDING >= square for m in range(1, self._cell_of(clock) + 1)
        )

    def reference(self, clock: float) -> tuple[Array, Array]:
        """Previewed configuration (nq,) and q′ (nv,) at ``clock``: what redundant arms follow."""
        self._leave_behind(clock)
        here = self._cells[0]
        ahead = self._cells[1] if len(self._cells) > 1 else here
        span = ahead.clock - here.clock
        share = min(max((clock - here.clock) / span, 0.0), 1.0) if span > 0.0 else 0.0
        model = self._cell.model
        slope = here.slope + share * (ahead.slope - here.slope)
        # Quadratic from the nearer border: exact to second order, continuous to third.
        q = pin.integrate(model, here.q, 0.5 * (here.slope + slope) * (share * span))
        return q, slope

    # -- building ------------------------------------------------------------------------------------------------

    def _extend(self, clock: float, dt: float, newton_steps: int) -> None:
        """Grow the horizon until the object could brake from full rate within it, or until that is all for now."""
        for _ in range(newton_steps):
            self._leave_behind(clock)
            if self._complete or self.blind or self._reaches(clock, dt):
                return
            self._work_ahead()

    def _reaches(self, clock: float, dt: float) -> bool:
        """Whether the object could brake from full rate at ``clock`` within the horizon."""
        cells = self._cells
        ahead = cells[min(self._cell_of(clock) + 1, len(cells) - 1)]
        enough = 1.0 + 2.0 * self._slope_cap * dt  # what a step at full rate uses up is still there after it
        return cells[-1].clock > clock + 2.0 * dt and cells[-1].cumulative - ahead.cumulative > enough

    def _work_ahead(self) -> None:
        """A piece of the next cell, so that no single step has to make a whole one."""
        if self._growing is None:
            self._growing = self._grow(self._cells[-1])
        try:
            next(self._growing)
        except StopIteration:
            self._growing, self._begin_at = None, np.inf

    def _leave_behind(self, clock: float) -> None:
        """Drop the cells that end before ``clock``."""
        while len(self._cells) > 1 and self._cells[1].clock <= clock:
            self._cells.popleft()

    def _grow(self, last: _Cell) -> Iterator[None]:
        """Add a cell; pauses after every Newton step."""
        path = self._path
        if path.duration - last.clock <= 1e-12:
            self._finish(last)
            return
        cell = yield from self._next(last)
        if self.blind:
            return
        if cell is None:
            self._block(last, self._singular_arm(last), LimitKind.REACH)
            return
        crossing = None if cell.inside else self._limit_crossing(last, cell)
        if crossing is not None:
            self._push(crossing)
            self._complete = True
            return
        if cell.squeeze < self.options.singular_rate**2 and cell.fastest > last.fastest:
            way = yield from self._past(cell)
            if not way:
                self._block(cell, self._singular_arm(cell), LimitKind.SINGULARITY)
                return
            for between in way[:-1]:
                self._push(between)
            cell = way[-1]
        breakpoint_ = path.next_breakpoint(last.clock)
        if abs(cell.clock - breakpoint_) < 1e-9 and breakpoint_ < path.duration:
            cell = self._corner(cell)
        self._push(cell)

    def _next(self, last: _Cell) -> Generator[None, None, _Cell | None]:
        """The border after ``last``, as far on as the chain can be followed in one go; None where it cannot."""
        path, options = self._path, self.options
        h = min(options.cell, path.duration - last.clock)
        if last.fastest > 0.0:
            h = min(h, options.joint_step / last.fastest)
        breakpoint_ = path.next_breakpoint(last.clock)
        if last.clock + h > breakpoint_ - 1e-9:
            h = breakpoint_ - last.clock
        while True:
            cell = yield from self._try(last, h)
            h *= 0.5
            if cell is not None or h < options.shortest or self.blind:
                return cell

    def _past(self, cell: _Cell) -> Generator[None, None, list[_Cell]]:
        """The borders from ``cell``, near a singularity, to where the joints slow down; none if there is no way."""
        least = (_PASSABLE * self.options.singular_rate) ** 2
        end = self._path.next_breakpoint(cell.clock) - 1e-9
        way = [cell]
        while len(way) < _LONGEST_WAY:
            ahead = yield from self._next(way[-1])
            if ahead is None or not ahead.inside or ahead.squeeze < least or ahead.clock > end:
                return []
            way.append(ahead)
            if ahead.fastest < way[-2].fastest:
                return way
        return []

    def _try(self, last: _Cell, h: float) -> Generator[None, None, _Cell | None]:
        """The chain at ``last.clock + h``, or None if Newton's method or the joints' slopes do not follow."""
        clock = last.clock + h
        ws, options = self._ws, self.options
        ahead = last.curvature * (0.5 * h)
        ahead += last.slope
        ahead *= h
        q = self._cell.moved(last.q, ahead)
        largest = np.inf
        for _ in range(4):
            if not self._newton_step(clock, q):
                return None
            yield
            np.abs(ws.velocity, out=ahead)
            largest = ahead.item(ahead.argmax())
            if not largest < options.joint_step:
                return None
            q = self._cell.moved(q, ws.velocity)
            if largest < _CONVERGED:
                break
        if not largest < _CONVERGED:
            return None
        if self._beyond_few_joints(ws.errors):
            self.blind = True
            return None
        cell = self._cell_at(clock, q, last)
        if h > options.shortest and not h * cell.fastest <= 1.5 * options.joint_step:
            return None
        if h > _FINE_CELL and not cell.change <= options.slope_step * cell.fastest:
            return None
        return cell

    def _beyond_few_joints(self, errors: Array) -> bool:
        """Whether errors (N, 6) are left that arms with few joints cannot make up for."""
        few = errors[list(self._chain.deficient)]
        return few.size > 0 and not np.abs(few).max() < _FOLLOWED

    def _newton_step(self, clock: float, q: Array, *, after: bool = False) -> bool:
        """Newton's step to the pose at ``clock`` into ``velocity``, q′ into ``along_velocity``; False if singular.

        Where the twist jumps, q′ is that before, or after.
        """
        ws, chain, path = self._ws, self._chain, self._path
        chain.place(q)
        chain.evaluate(q)
        before = max(min(clock, path.duration) - (0.0 if after else _JUST_BEFORE), 0.0)
        line = path.line_at(before, 0.0) if self._kernel.follows_lines else None
        if line is None:
            ws.set_pose(path.pose(clock))
            ws.along[:] = path.twist(before)
            ws.scalars[ws.ON_LINE] = 0.0
        else:
            if line is not self._line:
                ws.line[:] = self._line = line
            ws.scalars[ws.ON_LINE] = 1.0
        if ws.redundant:
            ws.null_along[:] = self._posture.velocity(q)
        ws.scalars[ws.HAS_PREDICTED] = 0.0  # nothing of the step before counts
        return self._kernel.step(0.0, before, -1.0) == Outcome.NOMINAL

    def _cell_at(self, clock: float, q: Array, last: _Cell | None) -> _Cell:
        """Bounds at a configuration on the path, from the slopes there (in the workspace) and at the cell before."""
        border, slope = self._border, self._ws.along_velocity.copy()
        border.before[:] = slope if last is None else last.slope
        border.positions[:] = q if self._cell.euclidean else self._cell.positions(q)
        span = 1.0 if last is None else clock - last.clock
        self._evaluate(span)
        fastest, change, by_speed, j_speed, by_bend, j_bend, cap, tightest, inside = border.result.tolist()
        squeeze = 1.0 / max(by_speed * by_speed, by_bend, 1.0)
        binding = None
        if cap < 1.0:
            if border.caps_speed and by_speed * by_speed >= by_bend:
                binding = self._joint_limit(int(j_speed), LimitKind.VELOCITY)
            else:
                binding = self._joint_limit(int(j_bend), LimitKind.ACCELERATION)
        decrease = min(self._slope_cap, 1.0 / tightest) if tightest > 0.0 else self._slope_cap
        cumulative = 0.0 if last is None else last.cumulative + 2.0 * decrease * span
        curvature = border.curvature.copy()
        return _Cell(
            clock, q, slope, cap, squeeze, cumulative, decrease, curvature, binding, fastest, change, inside != 0.0
        )

    def _finish(self, last: _Cell) -> None:
        """The end of the path: where it ends moving, the joints have one step to stop in."""
        if self.accelerates:
            end = self._jump_cap(np.zeros_like(last.slope), last.slope)
            if end < last.cap:
                arm, _, joint = "", "", ""
                self._push(last._replace(cap=end, binding=BindingLimit(arm, joint, LimitKind.PATH_END)))
        self._complete = True

    def _corner(self, cell: _Cell) -> _Cell:
        """A cell where the twist jumps: slopes after it, and the rate at which the joints can take the jump."""
        after_clock = cell.clock + 1e-9
        self._newton_step(after_clock, cell.q)
        after = self._ws.along_velocity.copy()
        cap, binding = cell.cap, cell.binding
        if self.accelerates:
            jump = self._jump_cap(after, cell.slope)
            if jump < cap:
                j = int((np.abs(after - cell.slope) / self._jump).argmax())
                cap, binding = jump, self._joint_limit(j, LimitKind.ACCELERATION)
        fastest = float(np.abs(after).max())
        return cell._replace(slope=after, cap=cap, binding=binding, curvature=np.zeros_like(after), fastest=fastest)

    def _jump_cap(self, after: Array, before: Array) -> float:
        """Largest σ² at which every joint can change its slope within one step."""
        jump = np.abs(after - before)
        moving = jump > 1e-9
        if not moving.any():
            return np.inf
        return float((self._jump[moving] / jump[moving]).min() ** 2)

    def _limit_crossing(self, last: _Cell, cell: _Cell) -> _Cell | None:
        """Where the first joint meets a position limit between two borders, as a cell at which the object rests."""
        x, ahead = (c.q if self._cell.euclidean else self._cell.positions(c.q) for c in (last, cell))
        # A joint outside may come back in; only going further out is the end.
        over = (ahead > np.maximum(self._high, x)) & (ahead > self._high)
        under = (ahead < np.minimum(self._low, x)) & (ahead < self._low)
        crossed = np.flatnonzero(over | under)
        if not crossed.size:
            return None
        limit = np.where(over[crossed], self._high[crossed], self._low[crossed])
        shares = np.clip((limit - x[crossed]) / (ahead[crossed] - x[crossed]), 0.0, 1.0)
        first = int(shares.argmin())
        j = int(crossed[first])
        at = self._cell_where(last, cell, j, float(limit[first]))
        return at._replace(cap=0.0, binding=self._joint_limit(j, LimitKind.POSITION))

    def _cell_where(self, last: _Cell, beyond: _Cell, j: int, position: float) -> _Cell:
        """The cell at which joint ``j`` is at ``position``, between two borders: regula falsi on the chain itself."""
        positions = self._cell.positions
        start, end = last.clock, beyond.clock
        miss_start, miss_end = (positions(c.q)[j] - position for c in (last, beyond))
        if miss_start * miss_end >= 0.0:
            return last  # it is there already
        best = beyond
        for _ in range(8):
            clock = start - miss_start * (end - start) / (miss_end - miss_start)
            cell = _whole(self._try(last, clock - last.clock)) if clock - last.clock > 1e-9 else last
            if cell is None:
                break
            best, miss = cell, float(positions(cell.q)[j] - position)
            if abs(miss) < 1e-9:
                break
            if miss * miss_end > 0.0:
                end, miss_end = clock, miss
            else:
                start, miss_start = clock, miss
        return best

    def _block(self, cell: _Cell, arm: int, kind: LimitKind) -> None:
        self._push(cell._replace(cap=0.0, binding=self._arm_limit(arm, kind)))
        self._complete = True

    def _singular_arm(self, cell: _Cell) -> int:
        share = np.abs(cell.slope) / np.where(np.isfinite(self._speed), self._speed, 1.0)
        return self._cell.arm_of_joint(int(share.argmax()))

    def _joint_limit(self, j: int, kind: LimitKind) -> BindingLimit:
        arm, _, joint = self._cell.joint_names[j].partition("/")
        return BindingLimit(arm, joint, kind)

    def _arm_limit(self, arm: int, kind: LimitKind) -> BindingLimit:
        return BindingLimit(self._cell.arm_names[arm], "", kind)

    def _push(self, cell: _Cell) -> None:
        self._cells.append(cell)
        if cell.cap >= 1.0:
            return  # no bound: the rate is never above 1
        key = cell.cap + cell.cumulative
        while self._bounds and self._bounds[-1].cap + self._bounds[-1].cumulative >= key:
            self._bounds.pop()
        self._bounds.append(cell)


def _between(here: _Cell, ahead: _Cell, clock: float) -> float:
    """z_cap between two borders. Without it the rate would rise within each cell, and fall again to its end."""
    span = ahead.clock - here.clock
    return ahead.cap + (here.cap - ahead.cap) * (ahead.clock - clock) / span if span > 0.0 else here.cap


def _whole(pieces: Generator[None, None, _Cell | None]) -> _Cell | None:
    """The result of work that pauses, without the pauses."""
    while True:
        try:
            next(pieces)
        except StopIteration as done:
            cell: _Cell | None = done.value
            return cell
