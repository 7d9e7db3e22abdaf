"""A new way while the object moves: a thread that looks ahead, searches detours and hands them to the controller."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol, final

import numpy as np
import pinocchio as pin

from coopqp.checks import as_scalar
from coopqp.errors import InvalidInputError, UnknownNameError
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.paths.path import ObjectPath
from coopqp.planning.route.detour import Detour, Detours, Motion
from coopqp.planning.route.tree import length_of
from coopqp.planning.starts import check_scene
from coopqp.spatial import Array, Placement, as_placement

if TYPE_CHECKING:
    from coopqp.collision.scene import CollisionScene

#: Of the time ahead, the share that a search may take.
_SEARCH_SHARE = 0.8
#: The path is left after this share of what is free of it, at the latest.
_FREE_SHARE = 0.5
#: Time of a search for an object that rests [s].
_AT_REST = 0.5
#: Time of steps until a search that found nothing is made again [s].
_AGAIN = 0.1
#: CollisionScene that move by less are where they were [m]; a turn of 1 rad counts as 0.3 m.
_SAME_PLACE = 1e-3
#: Samples of a path that tell its largest speed.
_SAMPLED_CLOCKS = 50
#: An object that follows its path at a lower rate rests.
_RESTS = 1e-3


class _Steps(Protocol):
    """What is read from a :class:`coopqp.ControlStep`."""

    q_next: Array
    clock_next: float
    dt: float
    rate: float
    sense: int


class _Followed(Protocol):
    """What is asked of a :class:`coopqp.QPController`."""

    cell: RobotCell
    grasp: Grasp
    constraints: Any

    @property
    def path(self) -> ObjectPath: ...

    @property
    def paused(self) -> bool: ...

    def follow(self, path: ObjectPath, *, clock: float = 0.0) -> None: ...


@dataclass(frozen=True, kw_only=True, eq=False)
class _Answer:
    """What a look ahead found: what blocks the way, the detour if there is one, and the time that it took [s]."""

    path: ObjectPath
    blocked: str = ""
    detour: Detour | None = None
    spent: float = 0.0


@final
class Replanner:
    """Finds a way round bodies that come into an object's way, while it moves.

    Tell where bodies are by :meth:`move`, and give every step to :meth:`watch`. When a body blocks the path ahead, a
    thread searches a way from a place ahead, along the path's tangent there, round it to the path's end; the controller
    follows it from that place on, without a stop. If none is found in time, the controller's :class:`coopqp.Clearance`
    stops the object, and the search goes on from where it rests.

    A detour keeps limits, σ_min and distances between its samples, too, as the edges of :func:`find_path` do, but it is
    not proved by :func:`check_path`. Elbows of redundant arms are led by the controller, and may be elsewhere.

    Args:
        controller: the controller, a :class:`coopqp.QPController`, with a :class:`coopqp.Clearance` of the same scene.
        scene: the bodies, a :class:`coopqp.CollisionScene` with those that move in ``moving``.
        lead: how far ahead the path is left [s]; a search takes 0.8 of it at most.
        clearance: distance that detours keep beyond the margins [m].
        seed: seed of the random numbers.
        simulated: for simulations, which know no time but that of the steps: searches run inside :meth:`watch`, and
            what they find is taken when as much time of the steps has gone by as they took of the processor.

    Attributes:
        found: detours that were followed.
        late: detours that were found too late.
        blocked: what blocks the way ahead; empty if nothing does.

    Raises:
        InvalidInputError: no scene, or bad numbers.
    """

    def __init__(
        self,
        controller: _Followed,
        scene: CollisionScene,
        *,
        lead: float = 0.2,
        clearance: float = 0.005,
        seed: int = 0,
        simulated: bool = False,
    ) -> None:
        where = "Replanner"
        check_scene(controller.cell, scene, f"{where}: scene")
        if scene is None:
            raise InvalidInputError("no scene", f"{where}: scene", "Give a CollisionScene with the moving bodies.")
        self._controller, self._scene = controller, scene
        self._lead = as_scalar(lead, f"{where}: lead", high=10.0)
        self._clearance = as_scalar(clearance, f"{where}: clearance", open_low=False, high=1.0)
        self._rng = np.random.default_rng(seed)
        self._clearances = [c for c in controller.constraints if getattr(c, "scene", None) is scene]
        self._places: dict[str, pin.SE3] = {}
        self._looked: tuple[ObjectPath, dict[str, pin.SE3]] | None = None
        self._fastest: tuple[ObjectPath, float] | None = None
        self._answer: _Answer | None = None
        self._now = self._due = self._next = 0.0
        self.found, self.late, self.blocked = 0, 0, ""
        self._asked: Callable[[], _Answer] | None = None
        self._wakes, self._closed = threading.Condition(), False
        self._busy = False
        self._error: Exception | None = None
        self._thread: threading.Thread | None = None
        if not simulated:
            self._thread = threading.Thread(target=self._run, name="coopqp replanner", daemon=True)
            self._thread.start()

    def __enter__(self) -> Replanner:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """End the thread; a search that runs ends at its time."""
        with self._wakes:
            self._closed = True
            self._wakes.notify_all()
        if self._thread is not None:
            self._thread.join()

    def move(self, name: str, T_world_body: Placement, twist: Sequence[float] = (0.0,) * 6) -> None:
        """Tell where a moving body is now; the controller's Clearance is told, too.

        Args:
            name: name of a body of ``scene.moving``.
            T_world_body: placement of its shape in the world.
            twist: its velocity, for the Clearance, as in :meth:`coopqp.Clearance.move`; it is searched where it is now.

        Raises:
            UnknownNameError, InvalidInputError: no such body, or no numbers.
        """
        T = as_placement(T_world_body, f"Replanner.move '{name}'")
        known = tuple(body.name for body in self._scene.moving)
        if name not in known:
            raise UnknownNameError("moving body", str(name), known, "Replanner.move")
        for clearance in self._clearances:
            clearance.move(name, T, twist)
        self._places[name] = T

    def watch(self, step: _Steps) -> bool:
        """Look at a step of the controller, after it. True if the object goes another way from the next step on."""
        if self._error is not None:
            error, self._error, self._busy = self._error, None, False
            raise error
        self._now += step.dt
        if self._busy and self._answer is not None and self._now >= self._due:
            return self._take(self._answer, step)
        path = self._controller.path
        if (
            self._busy
            or self._now < self._next
            or step.sense != 1
            or self._controller.paused
            or not np.isfinite(path.duration)
        ):
            return False
        if self._looked is not None and self._looked[0] is path and _same(self._looked[1], self._places):
            return False
        places = dict(self._places)
        self._looked = path, places
        cell = self._controller.cell
        motion = Motion(path=path, clock=step.clock_next, rate=step.rate, x=cell.positions(step.q_next))
        ask = self._asking(motion, places)
        self._busy = True
        if self._thread is None:
            began = time.thread_time()
            self._answer = ask()
            self._due = self._now + time.thread_time() - began
        else:
            self._due = 0.0
            with self._wakes:
                self._asked = ask
                self._wakes.notify_all()
        return False

    def _take(self, answer: _Answer, step: _Steps) -> bool:
        """Follow a detour where the object leaves its path; forget one that comes too late."""
        controller, detour = self._controller, answer.detour
        self.blocked = answer.blocked
        if detour is None or controller.path is not answer.path:
            self._busy, self._answer = False, None
            if answer.blocked:
                self._looked, self._next = None, self._now + _AGAIN  # from where the object is by then
            return False
        before = detour.leaves - step.clock_next
        rests = detour.begins == 0.0
        ahead = step.rate * step.dt
        if not rests and before > 0.5 * ahead:
            return False
        self._busy, self._answer, self._looked = False, None, None
        if abs(before) > (_RESTS if rests else ahead):
            self.late += 1
            return False
        past = 0.0 if rests else -before / max(step.rate, _RESTS)
        controller.follow(detour.path, clock=max(detour.begins + past, 0.0))
        self.found += 1
        self.blocked = ""
        return True

    def _asking(self, motion: Motion, places: dict[str, pin.SE3]) -> Callable[[], _Answer]:
        """The search as a call without arguments."""
        controller = self._controller
        if self._fastest is None or self._fastest[0] is not motion.path:
            clocks = np.linspace(motion.clock, motion.path.duration, _SAMPLED_CLOCKS)
            twists = [motion.path.twist(float(clock)) for clock in clocks]
            fastest = max(length_of(V[:3], V[3:]) for V in twists)
            before = 0.0 if self._fastest is None else self._fastest[1]
            self._fastest = motion.path, max(fastest, before)
        fastest = self._fastest[1]

        def ask() -> _Answer:
            began = time.perf_counter()
            scene = self._scene.standing(places)
            detours = Detours(
                controller.cell, controller.grasp, scene, clearance=self._clearance, fastest=fastest, rng=self._rng
            )
            blocked = detours.blocked(motion)
            if blocked is None:
                return _Answer(path=motion.path)
            rests = motion.rate <= _RESTS
            ahead = 0.0 if rests else min(motion.rate * self._lead, _FREE_SHARE * (blocked[0] - motion.clock))
            leaves = motion.clock + ahead
            until = began + (_AT_REST if rests else _SEARCH_SHARE * ahead / motion.rate)
            detour = detours.detour(motion, leaves=leaves, until=until)
            return _Answer(path=motion.path, blocked=blocked[1], detour=detour)

        return ask

    def _run(self) -> None:
        """The thread."""
        while True:
            with self._wakes:
                self._wakes.wait_for(lambda: self._closed or self._asked is not None)
                if self._closed:
                    return
                asked, self._asked = self._asked, None
            assert asked is not None
            try:
                self._answer = asked()
            except Exception as error:  # told where the steps are watched
                self._error = error


def _same(before: dict[str, pin.SE3], now: dict[str, pin.SE3]) -> bool:
    """Whether all bodies are where they were."""
    if before.keys() != now.keys():
        return False
    return all(_apart(before[name], T) <= _SAME_PLACE for name, T in now.items())


def _apart(a: pin.SE3, b: pin.SE3) -> float:
    return length_of(b.translation - a.translation, np.asarray(pin.log3(a.rotation.T @ b.rotation)))
