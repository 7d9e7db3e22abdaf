"""How close bodies came in a run, from its commanded configurations alone, also between its steps.

The controllers' bounds and rows play no part in it: bodies are placed by Pinocchio's kinematics, and coal computes the
distance of two bodies. Their motion between samples bounds the change of their distance, so few distances are computed.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, final

import coal
import numpy as np
import pinocchio as pin

from coopqp.collision.coal_geometry import reach_of
from coopqp.collision.distances import Distances, new_request
from coopqp.collision.scene import CollisionScene
from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.shapes import Body, Box, NearPair
from coopqp.paths.scenario import Scenario
from coopqp.simulation.recording.bodies import describe_bodies, describe_carried
from coopqp.simulation.recording.recording import Recording
from coopqp.spatial import Array

#: Number of parts of a step in which bodies may have been closest.
PARTS = 4
#: A body's way between two samples is at most this many times the way that its placements show.
_BENT = 1.05
#: Largest number of evaluated samples; of longer runs every second, third, … sample.
MOST_JUDGED = 50_000
#: Samples of the distances over a run.
MOST_SAMPLES = 200
#: Shapes with a radius about a point or a segment.
_ROUND = (coal.Sphere, coal.Capsule)
#: The least distance of a run is found to within this [m].
RESOLUTION = 1e-6


@final
@dataclass(frozen=True)
class Closest:
    """Where two bodies came closest.

    Attributes:
        pair: the bodies, and their distance [m].
        time: when [s].
        margin: the least distance that they are to keep [m].
        starts_inside: they may start inside their margin, and come no closer then.
    """

    pair: NearPair
    time: float
    margin: float
    starts_inside: bool = False

    def __str__(self) -> str:
        return f"{1e3 * self.pair.distance:.3g} mm, {self.pair.first} and {self.pair.second} at {self.time:.3g} s"


class _Placed(NamedTuple):
    R: Array  # (T, G, 3, 3)
    p: Array  # (T, G, 3)
    way: Array  # (T, G): largest motion of any of its points since the first sample [m]


@final
class Closeness:
    """Distances of one scene over a run.

    Args:
        scene: the pairs, with their margins. Pairs with bodies that move by themselves are left out.
    """

    def __init__(self, scene: CollisionScene) -> None:
        built, self._model = scene.built, scene.cell.model
        shapes = list(built.geometry.geometryObjects)
        self._joints = [int(shape.parentJoint) for shape in shapes]
        self._T = [shape.placement.copy() for shape in shapes]
        self._shapes = [shape.geometry for shape in shapes]
        self._extent = np.array([reach_of(shape, np.eye(3), np.zeros(3)) for shape in self._shapes])
        self._radius = [shape.radius if isinstance(shape, _ROUND) else 0.0 for shape in self._shapes]
        self._request, self._result = new_request(), coal.DistanceResult()
        moving = set(built.moving)
        ends = [(int(pair.first), int(pair.second)) for pair in built.geometry.collisionPairs]
        self._pairs = [k for k, pair in enumerate(ends) if not moving & set(pair)]
        self._ends, self._labels, self.margins, self._inside = ends, built.labels, built.margins, built.inside
        self._data = self._model.createData()

    def at(self, q: Array, pair: int) -> float:
        """Distance of a pair of shapes at a configuration (nq,) [m].

        Shapes that overlap are no deeper in each other than the sum of their radii, those of spheres and capsules.
        """
        pin.forwardKinematics(self._model, self._data, q)
        i, j = self._ends[pair]
        A, B = self._data.oMi[self._joints[i]] * self._T[i], self._data.oMi[self._joints[j]] * self._T[j]
        return self._apart(pair, A.rotation, A.translation, B.rotation, B.translation)

    def closest(self, q: Array, time: Array, *, to_margin: bool = False, without_start: bool = False) -> Closest | None:
        """The least distance of a run; None without pairs.

        Args:
            q: commanded configurations (T, nq).
            time: time of each (T,) [s].
            to_margin: the least distance less its margin instead. A pair that may start inside its margin, and comes no
                closer then, has the distance at the first configuration for one.
            without_start: leave out pairs of names that overlap at the first configuration.
        """
        placed = self._place(q)
        required = self._required_at(placed)
        less = required.tolist() if to_margin else [0.0] * len(required)
        least, last = (np.inf, -1, 0.0), len(q) - 1  # distance less what it is less of, pair, sample
        queue: list[tuple[float, int, int, int, float, float]] = []
        left_out = self.overlapping(q[0]) if without_start else set()
        for k in self._pairs:
            if self._labels[k] in left_out:
                continue
            heapq.heappush(queue, (float(self._away(placed, k).min()) - less[k], k, -1, last, 0.0, 0.0))
        while queue:
            bound, k, first, end, d_first, d_end = heapq.heappop(queue)
            if bound >= least[0] - RESOLUTION:
                break
            found, parts = list[tuple[float, float]](), list[tuple[int, int, float, float]]()
            if first < 0:
                d_first, d_end = self._sampled(placed, k, 0), self._sampled(placed, k, last)
                found = [(d_first, 0.0), (d_end, float(last))]
                parts = [(0, last, d_first, d_end)]
            elif end - first > 1:
                middle = (first + end) // 2
                d = self._sampled(placed, k, middle)
                found = [(d, float(middle))]
                parts = [(first, middle, d_first, d), (middle, end, d, d_end)]
            else:
                step = pin.difference(self._model, q[first], q[end])
                for part in range(1, PARTS):
                    share = part / PARTS
                    found.append((self.at(pin.integrate(self._model, q[first], share * step), k), first + share))
            for d, where in found:
                if d - less[k] < least[0]:
                    least = (d - less[k], k, where)
            for a, b, d_a, d_b in parts:
                if b > a:
                    lower = 0.5 * (d_a + d_b - self._way(placed, k, a, b))
                    heapq.heappush(queue, (min(lower, d_a, d_b) - less[k], k, a, b, d_a, d_b))
        value, k, where = least
        if k < 0:
            return None
        at = float(np.interp(where, np.arange(len(time)), time))
        pair = NearPair(*self._labels[k], value + less[k])
        return Closest(pair, at, float(required[k]), bool(self._inside[k]))

    def overlapping(self, q: Array) -> set[tuple[str, str]]:
        """Pairs of names that overlap at a configuration (nq,)."""
        placed = self._place(q[None])
        found = set()
        for k in self._pairs:
            if self._away(placed, k)[0] <= 0.0 and self._sampled(placed, k, 0) <= 0.0:
                found.add(self._labels[k])
        return found

    def start(self, q: Array) -> None:
        """Begin to :meth:`watch` at a configuration (nq,)."""
        placed = self._place(q[None])
        self._least = self._required_at(placed)
        self._rooms = np.full(len(self._least), np.inf)
        for k in self._pairs:
            self._rooms[k] = self._away(placed, k)[0] - self.margins[k]

    def _required_at(self, placed: _Placed) -> Array:
        """The distance that each pair keeps (P,) after the first configuration [m]."""
        required = self.margins.copy()
        for k in self._pairs:
            if self._inside[k]:
                required[k] = min(required[k], self._sampled(placed, k, 0))
        return required

    def watch(self, q: Array, *, tolerance: float) -> list[tuple[int, NearPair, float]]:
        """Steps of a run in which pairs are closer than they may be, by more than a tolerance [m].

        Pairs that may start inside their margin are to come no closer than they are at :meth:`start`.

        Args:
            q: commanded configurations (T + 1, nq); the first is the last one of the call before, or the start.
            tolerance: accepted [m].

        Returns:
            number of the step, the pair with its least distance in the step, the missing distance [m].
        """
        placed, found = self._place(q), []
        ends = np.array(self._ends, dtype=int).reshape(-1, 2)
        for t in range(1, len(q)):
            step = _BENT * (placed.way[t] - placed.way[t - 1])
            way = step[ends[:, 0]] + step[ends[:, 1]]
            self._rooms -= way
            for k in np.flatnonzero(self._rooms < -tolerance):
                required = float(self._least[k])
                d = self._sampled(placed, int(k), t)
                self._rooms[k] = d - required
                if d - required - way[k] < -tolerance and way[k] > 0.0:
                    turn = pin.difference(self._model, q[t - 1], q[t])
                    for part in range(1, PARTS):
                        d = min(d, self.at(pin.integrate(self._model, q[t - 1], part / PARTS * turn), int(k)))
                room = d - required
                if room < -tolerance:
                    found.append((t - 1, NearPair(*self._labels[k], room + required), -room))
        return found

    def names(self, pair: int) -> list[str]:
        """Names of the two bodies of a pair of shapes."""
        return [str(name) for name in self._labels[pair]]

    def pairs_without(self, left_out: Iterable[tuple[str, str]]) -> list[int]:
        """Pairs of shapes, without the pairs of these names."""
        names = set(left_out)
        return [k for k in self._pairs if self._labels[k] not in names]

    def over_time(self, q: Array, pairs: Sequence[int] | None = None) -> Array:
        """Least distance at each configuration (T,) [m].

        Args:
            q: configurations (T, nq).
            pairs: numbers of the pairs of shapes; all by default.
        """
        placed, out = self._place(q), np.full(len(q), np.inf)
        for k in self._pairs if pairs is None else pairs:
            for t in np.flatnonzero(self._away(placed, k) < out).tolist():
                out[t] = min(out[t], self._sampled(placed, k, t))
        return out

    def _away(self, placed: _Placed, k: int) -> Array:
        """Lower bound of the distance of a pair at each sample (T,) [m], by spheres about both bodies' origins."""
        i, j = self._ends[k]
        return np.linalg.norm(placed.p[:, i] - placed.p[:, j], axis=1) - self._extent[i] - self._extent[j]

    def _way(self, placed: _Placed, k: int, first: int, end: int) -> float:
        """Largest motion of the two bodies of a pair against each other between two samples [m]."""
        i, j = self._ends[k]
        return _BENT * float(placed.way[end, i] - placed.way[first, i] + placed.way[end, j] - placed.way[first, j])

    def _sampled(self, placed: _Placed, k: int, t: int) -> float:
        i, j = self._ends[k]
        R, p = placed.R[t], placed.p[t]
        return self._apart(k, R[i], p[i], R[j], p[j])

    def _apart(self, k: int, Ra: Array, pa: Array, Rb: Array, pb: Array) -> float:
        """Distance of a pair. The depth of an overlap is not always found: the radii bound it."""
        i, j = self._ends[k]
        A, B = coal.Transform3s(Ra, pa), coal.Transform3s(Rb, pb)
        self._result.clear()
        coal.distance(self._shapes[i], A, self._shapes[j], B, self._request, self._result)
        return max(float(self._result.min_distance), -self._radius[i] - self._radius[j])

    def _place(self, q: Array) -> _Placed:
        """All bodies at configurations (T, nq)."""
        used, shape_joint = np.unique(self._joints, return_inverse=True)
        placed = np.empty((len(q), len(used), 4, 4))
        for row, out in zip(q, placed, strict=True):
            pin.forwardKinematics(self._model, self._data, row)
            for k, joint in enumerate(used.tolist()):
                out[k] = self._data.oMi[joint].homogeneous
        shapes = placed[:, shape_joint] @ np.array([T.homogeneous for T in self._T])
        rotations, origins = shapes[..., :3, :3], shapes[..., :3, 3]
        way = np.zeros((len(q), len(shape_joint)))
        if len(q) > 1:
            shift = np.linalg.norm(np.diff(origins, axis=0), axis=2)
            # The chord of a turn: ‖R₁ − R₀‖ = 2√2 sin(θ/2); its arc θ is at most π/2 times 2 sin(θ/2).
            turn = np.linalg.norm(np.diff(rotations, axis=0), axis=(2, 3)) / np.sqrt(2.0)
            way[1:] = np.cumsum(shift + turn * self._extent, axis=0)
        return _Placed(rotations, origins, way)


def default_scene(scenario: Scenario) -> CollisionScene | None:
    """The bodies of a scenario without margins, to evaluate runs; None where its arms have no shapes."""
    box = Body("object", Box(scenario.object_size), scenario.T_object_body)
    return _plain_scene(scenario.cell, scenario.grasp, box, scenario.obstacles)


def overlaps(cell: RobotCell, grasp: Grasp, box: Body, q: Array) -> list[tuple[str, str]]:
    """Pairs of names among links and the object (a box) that overlap at a configuration (nq,), in their order."""
    scene = _plain_scene(cell, grasp, box, ())
    return [] if scene is None else sorted(Closeness(scene).overlapping(q))


def _plain_scene(cell: RobotCell, grasp: Grasp, box: Body, obstacles: Sequence[Body]) -> CollisionScene | None:
    if all(arm.collision is None or not arm.collision.ngeoms for arm in cell.arms):
        return None
    try:
        return CollisionScene(cell=cell, grasp=grasp, carried=[box], obstacles=obstacles, margin=0.0)
    except InvalidInputError:  # a shape of the description that no distance is defined for
        return None


def _object_elsewhere(recording: Recording) -> bool:
    """Whether the first arm's tool moves on the object along a program: a scene places the object by it."""
    shift = recording.shift if recording.metadata.get("phases") else None
    return shift is not None and bool(np.abs(shift[:, 0]).max(initial=0.0) > 0.0)


def with_clearance(recording: Recording, scene: CollisionScene | None, *, avoided: bool) -> Recording:
    """The recording with an entry ``clearance`` in its metadata: where bodies came closest.

    Entries: ``closest_m``, ``between``, ``time_s``, ``margin_m``, ``starts_inside`` (the pair may, and has its distance
    at the start for a margin), ``avoided``, ``left_out`` (pairs of names that overlap at the start of a run without
    avoidance: the distances of these are not checked), ``times_s``, ``distances_m`` and ``points_m``, the nearest
    points of both bodies, and ``pairs``, their names. Where all pairs are left out only ``avoided`` and ``left_out``
    are there. ``notes`` are those of the scene. Entries ``bodies`` and ``carried`` hold what stands in the world and
    what the object is made of.
    """
    if scene is None or _object_elsewhere(recording):
        return recording
    closeness = Closeness(scene)
    every = -(-len(recording.time) // MOST_JUDGED)
    q, time = recording.q_command[::every], recording.time[::every]
    left_out = sorted(set() if avoided else closeness.overlapping(q[0]))
    found = closeness.closest(q, time, without_start=not avoided)
    missing = closeness.closest(q, time, to_margin=True) if avoided else None
    if missing is not None and missing.pair.distance < missing.margin - RESOLUTION:
        found = missing  # another pair may be nearer, and keep its margin
    drawn = {"bodies": describe_bodies(scene), "carried": describe_carried(scene, recording.metadata.get("object"))}
    drawn = {key: entries for key, entries in drawn.items() if entries}
    recording = replace(recording, metadata={**recording.metadata, **drawn})
    entry: dict[str, Any] = {"avoided": avoided, "left_out": [list(pair) for pair in left_out]}
    if scene.notes:
        entry["notes"] = list(scene.notes)
    if found is None:
        return replace(recording, metadata={**recording.metadata, "clearance": entry}) if left_out else recording
    rows = np.unique(np.linspace(0, len(q) - 1, MOST_SAMPLES).round().astype(int))
    distances, points, pairs = _nearest(scene, closeness, q[rows], closeness.pairs_without(left_out))
    touching = np.flatnonzero(np.array(distances) <= 0.0)
    since = touching[0] if len(touching) else -1  # of what has touched, when and where it began
    entry |= {
        "closest_m": found.pair.distance,
        "between": [found.pair.first, found.pair.second] if since < 0 else list(pairs[since]),
        "time_s": found.time if since < 0 else float(time[rows[since]]),
        "margin_m": found.margin,
        "starts_inside": found.starts_inside,
        "times_s": time[rows].tolist(),
        "distances_m": distances,
        "points_m": points,
        "pairs": pairs,
    }
    return replace(recording, metadata={**recording.metadata, "clearance": entry})


def _nearest(
    scene: CollisionScene, closeness: Closeness, q: Array, pairs: list[int]
) -> tuple[list[float], list[list[list[float]]], list[list[str]]]:
    """The nearest pair at configurations (T, nq), for pictures: distances (T,) [m], points (T, 2, 3) [m], names (T, 2).

    The controllers' distances choose the pair; its distance is that of ``closeness``.
    """
    distances, apart, points, names = Distances(scene.built), list[float](), [], []
    for row in q:
        k = pairs[int(distances.all(row)[pairs].argmin())]
        apart.append(closeness.at(row, k))
        points.append([point.tolist() for point in distances.nearest_points(k)])
        names.append(closeness.names(k))
    return apart, points, names
