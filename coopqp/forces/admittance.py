"""Relax the forces between the arms: the object stays on its path, the grasps in the controller give way.

Wrist sensors tell the wrench ``w_k`` of each arm on the object. The load is shared with the least wrenches at the
tools, S; the rest is internal: ``w_s = (I − S Σ) w``. A push ``w_s,k`` displaces arm k by
``e_k = C_k w_s,k``, with the compliance of its servos ``C_k = A_k Kp⁻¹ A_kᵀ``. So its place on the object moves by

    ``u_k = −(e_k − Σ_j s_j e_j) / (ρ T) + σ D_k,   d_k ← d_k + u_k dt,   X_k ← exp(d_k) X_k``

with the shares s of the common error, so that the object stays. ρ is the servos' real stiffness over the given one.
Where a base is off, the grasps have to move as the object does: D is what the path asks for at the full rate, learned
in the time T_D, ``D_k ← D_k − σ (e_k − Σ_j s_j e_j) / (ρ T) dt / T_D``.

Where arms mind forces in some directions only, F takes from the wrenches what they mind, and Fᵀ from the grasps what
may move; the others keep their commanded places. Grasps that move by d change the internal wrenches by −G d, with the
stiffness of the grip ``G = C⁻¹ − C⁻¹ Σᵀ (Σ C⁻¹ Σᵀ)⁻¹ Σ C⁻¹`` of all C_k together. So ``e = Fᵀ (F G Fᵀ)⁺ F w_s``: every
force that is minded decays with T (all of them minded, that is C w_s again). C alone leaves forces that take up to 250
times as long, where the master keeps its place: its own compliance is missing then.

Joints that arms share give way to the sum of their arms' wrenches: C has blocks beside its diagonal for them, which
take no part in relaxing forces between these arms alone, ``Σ w_s = 0``.

Along a program the arms that hold the object do this alone, see :mod:`coopqp.forces.holding`.

The loop is 1 / (T s) · exp(−d s). It is damped well if (d + dt) / T is at most 1/2, doubts about the servos included.
"""

from __future__ import annotations

import copy
import math
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.control.core.force_memory import gives_way, relaxation_scalars, relaxation_size, relaxation_views
from coopqp.control.monitoring.stress import servo_wrenches
from coopqp.core import _core
from coopqp.core._core import BY_RELEASE, LOOK_EVERY
from coopqp.errors import InvalidInputError
from coopqp.forces.force_options import ForceOptions
from coopqp.forces.holding import Holding, Holds, Moved, SharesOf
from coopqp.forces.internal import per_joint
from coopqp.forces.presses import of_grip
from coopqp.forces.sensor_check import SensorCheck
from coopqp.model.cell import RobotCell
from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp
from coopqp.spatial import Array, for_twists

#: Smaller shares of a stiffness count as 0.
_LEAST_PART = 1e-9
#: Metric of torques where the size of a wrench is told [m].
_LENGTH = 0.3
#: Largest (d + dt) / T with the doubt.
_LARGEST_GAIN = 0.5
#: The same with the delay that was measured: beyond it a sensor is late.
_LATEST = 0.55
#: The same where it relaxes more slowly for a sensor that is late, up to this delay [s].
_SLOWED_GAIN, _TOO_LATE = 0.4, 0.15
#: Pressing: force at which it ends [N], first and last distance [m], speed [m/s].
_PRESS, _PRESS_LEAST, _PRESS_MOST, _PRESS_SPEED = 3.0, 1e-5, 5e-4, 5e-4
#: Range of the measured ρ. Softer servos than given are not answered faster, as their damping need not be softer; but
#: their deflection is judged by it.
_STIFFEST = (0.05, 20.0)
#: While the arms press at rest, where no grasp answers wrenches, sensors may be silent for so many times silent_time.
_SILENT_AT_REST = 4.0
#: Probability of lost samples in a row from which on they are silence, and the largest share of lost ones that counts.
_NO_CHANCE, _MOST_LOST = 1e-6, 0.5
#: Attributes that change.
_VARYING = ("_pressed", "_pressing", "_waited", "_felt", "_grows", "_base", "_soft")
#: A contact pushes with at least this share of the payload's weight, and this force [N], if nothing else is told.
_CONTACT, _LEAST_CONTACT = 0.2, 25.0
#: A direction is called by an axis from this cosine on.
_ALONG = 0.95
#: Time for which palms press steadily before the object moves [s], and the share of the squeeze that may be missing.
_STEADY, _PRESSED = 0.5, 0.1
#: The settings that a step needs, by their place in its memory.
_SETTINGS = {
    "wrench_filter": "filter_time", "dead_band": "dead_band", "relax_time": "relax_time", "drift_time": "drift_time",
    "ramp_time": "ramp_time", "wrench_silence": "silent_time",
    "most_speed": "speed", "most_spin": "spin", "most_reach": "reach", "most_turn": "turn",
    "force_slows": "slow_from", "force_holds": "hold_from", "squeeze": "squeeze", "most_squeeze": "most_squeeze",
}  # fmt: skip


@final
class Relaxation:
    """Internal wrenches, and how the grasps give way to them.

    Args:
        cell, grasp: the arms, and how they are told to hold the object.
        options: settings.
        dt: nominal length of a step [s].
        shares_of: s, share of each arm in the object's pose (N, 6) while some of them hold it (N,).

    Attributes:
        memory: numbers of ``ForceRelaxation`` in ``force_relaxation.h``, and the vectors below.
        scalars: the first of them by name.
        internal: internal wrenches of the arms on the object beside the squeeze that is asked for, filtered (N, 6)
            [N, N·m], in the object frame; the next step changes it in place.
        seen: the last wrenches at the tools (N, 6) [N, N·m]; the next step changes it in place.
        holding: which arms hold the object, and what follows from that.
        shift: d, the motion by which each grasp has given way, in the object frame (N, 6) [m, rad]; the next step
            changes it in place.
        silent: time since each arm's last wrench (N,) [s]; the next step changes it in place.

    Raises:
        InvalidInputError: bad settings, also those with which forces would swing.
    """

    def __init__(self, cell: RobotCell, grasp: Grasp, options: ForceOptions, *, dt: float, shares_of: SharesOf) -> None:
        self.options, self._dt, n = options, dt, len(cell)
        if options.stiffness is None:
            raise InvalidInputError("no stiffness", "ForceOptions", "Give the stiffness of the joint servos.")
        gain = options.softness_doubt * (options.delay + dt) / options.relax_time
        if gain > _LARGEST_GAIN * (1.0 + 1e-9):
            raise InvalidInputError(
                f"forces would swing: softness_doubt (delay + dt) / relax_time is {gain:.2f}, above {_LARGEST_GAIN:g}",
                "ForceOptions",
                f"Give a relax_time of at least {gain / _LARGEST_GAIN * options.relax_time:.3g} s.",
            )
        self._cell, self._chain = cell, Chain(cell, grasp)
        self._softness = 1.0 / per_joint(options.stiffness, cell.nv, "ForceOptions: stiffness")
        self.holding = Holding(cell, grasp, options, shares_of)
        self.memory = np.zeros(relaxation_size(n))
        self.scalars = relaxation_scalars(self.memory)
        self._put_settings()
        views = self._views = relaxation_views(self.memory, n)
        self.internal, self.shift, self.silent = views["internal"], views["shift"], views["silent"]
        self.seen, self._yields, self._compliances = views["seen"], views["yields"], views["compliances"]
        #: Compliances of the arms' own joints, and of those that they share, at the last look.
        self._own, self._shared = np.zeros((n, 6, 6)), None if not cell.groups else np.zeros((6 * n, 6 * n))
        self._held, self._reference = views["held"], views["reference"]
        self._put_load()
        self._starting = self.memory.copy()
        self.begin(np.zeros((n, 6)))

    def _put_settings(self) -> None:
        o, m = self.options, self.scalars
        for place, name in _SETTINGS.items():
            setattr(m, place, getattr(o, name))
        palms = o.palms is not None
        m.has_palms = palms
        m.wait_time = _STEADY if palms else 2.0 * o.relax_time
        m.pressed_below = _PRESSED * o.squeeze if palms else math.inf
        m.move_below = max(o.move_below, 2.0 * o.dead_band, _PRESSED * o.squeeze)

    def _put_load(self) -> None:
        """What the drives are fed forward: the payload's weight, or the sum of all wrenches."""
        payload, m = self.options.payload, self.scalars
        m.rigid = self.options.palms is None
        m.contact_limit = math.inf
        if payload is None:
            return
        self._views["centre"][:] = payload.centre
        weight = -payload.mass * self._cell.model.gravity.linear
        m.weight_x, m.weight_y, m.weight_z = weight
        m.load_mass, m.contact_late = payload.mass, self.options.delay + self._dt
        limit = self.options.contact_limit
        least = max(_LEAST_CONTACT, _CONTACT * float(np.linalg.norm(weight)))
        if self.options.palms is not None:  # a stand hides what the object weighs until it moves
            least = math.inf
        m.contact_limit = least if limit is None else limit

    def begin(self, shift: Array) -> None:
        """Forget everything; the grasps are shifted by ``shift`` (N, 6)."""
        n, m = len(self._cell), self.scalars
        asked = m.asked
        self.memory[:] = self._starting
        self.holding.put(self._views, 1.0)
        m.asked, m.stiffer, self.shift[:], self._held[:] = asked, 1.0, shift, shift
        m.look_at = math.inf
        m.force_cap, m.pressed_with = 1.0, self.options.squeeze
        m.correction_share = self.options.palms is not None
        #: One over Kp, with the arms' stiffness against each other as it is found.
        self._soft = self._softness
        self._pressed = self._pressing = self._waited = 0.0
        self._felt: Array | None = None
        self._grows, self._base = np.zeros(6 * n), np.zeros((n, 6))

    def kept(self) -> dict[str, Any]:
        """The state of a copy."""
        own = {name: getattr(self, name) for name in _VARYING}
        return {"memory": self.memory.copy(), "holding": self.holding.kept(), **own}

    def restore(self, kept: dict[str, Any]) -> None:
        """Go on from what :meth:`kept` returned."""
        self.memory[:] = kept["memory"]
        self.holding.restore(kept["holding"])
        self._chain.place(self.holding.moved)
        vars(self).update({name: copy.deepcopy(kept[name]) for name in _VARYING})

    # -- who holds the object ------------------------------------------------------------------------------------

    def start_with(self, holds: Holds, bears: Holds, moved: Moved) -> None:
        """These arms hold the object at the start (N,), and bear its load; :meth:`begin` follows."""
        self.holding.start(holds, bears, moved)
        self._chain.place(self.holding.moved)

    def take_holding(self, holds: Holds, bears: Holds, moved: Moved, q: Array) -> None:
        """Other arms may hold the object from now on (N,), or bear its load, commanded at ``q`` (nq,).

        The grasp of an arm that attaches begins where its tool is; what the path asks of an arm that lets go is
        forgotten, and that of the others is counted from their common motion.
        """
        before = np.array(self.holding.holds)
        if not self.holding.take(holds, bears, moved):
            return
        if holds == tuple(before):
            return
        self._chain.place(self.holding.moved)
        for k in np.flatnonzero(before != np.array(holds)):
            self._views["freed"][k], self.internal[k], self._views["felt"][k] = 0.0, 0.0, 0.0
            if holds[k]:
                self._held[k] = self.shift[k]
        drift = self._views["drift"]
        drift[:] = (self.holding.relative @ drift.ravel()).reshape(-1, 6)
        self.scalars.relax_blend = 0.0
        self._put_holding()
        self.look(q)

    def hand_on(self, dt: float) -> None:
        """Let the load go over to the arms that bear it, for a time [s]."""
        if self.holding.hand_on(dt):
            self._put_holding()

    def allow_release(self, k: int) -> float:
        """The largest rate of the object ahead of a release of arm k: none while it presses on the object."""
        m = self.scalars
        force = float(np.linalg.norm(self.internal[k, :3]))
        if self.options.palms is None and force > m.move_below and m.allowed > 0.0:
            m.why, m.why_arm, m.allowed = BY_RELEASE, k, 0.0
        return float(m.allowed)

    def _put_holding(self) -> None:
        o = self.options
        self.holding.put(self._views, self.scalars.pressed_with / o.squeeze if o.palms is not None else 1.0)

    @property
    def size(self) -> float:
        """Size of the largest internal wrench [N]; a torque of 0.3 N·m counts as 1 N."""
        return self.scalars.largest_force

    @property
    def stiffer(self) -> float:
        """ρ."""
        return self.scalars.stiffer

    # -- a step --------------------------------------------------------------------------------------------------

    def step(self, wrenches: Array | None, dt: float) -> int:
        """Take wrenches at the tools, and move the grasps: ``relax.cpp``.

        Args:
            wrenches: (N, 6) [N, N·m], ``dt`` seconds after the last ones; None or NaN for missing ones.
            dt: length of the step [s].

        Returns:
            ``HEARD``; ``MISSED`` if a wrench is missing, ``SILENT`` if one has been missing for too long.
        """
        heard: int = _core.relax(self.memory, len(self._cell), wrenches, dt)
        return heard

    def refer(self, pose: pin.SE3, dt: float) -> None:
        """The object was asked for at ``pose``, in a step of ``dt`` [s]."""
        m = self.scalars
        m.reference_dt, m.asked_dt = m.asked_dt, dt
        self._reference[:9], self._reference[9:] = pose.rotation.ravel(), pose.translation

    def contact(self) -> str:
        """The force and the direction of what touches the object, in words."""
        force = self._views["push"][2]
        size = float(np.linalg.norm(force))
        way = force / max(size, 1e-9)
        k = int(np.abs(way).argmax())
        if abs(way[k]) > _ALONG:
            towards = f"{'+-'[int(way[k] < 0.0)]}{'xyz'[k]}"
        else:
            towards = "({:.1f}, {:.1f}, {:.1f})".format(*(np.round(way, 1) + 0.0))  # no -0.0
        limit = self.scalars.contact_limit
        return f"{size:.0f} N have pushed it towards {towards} of the world (from {limit:.0f} N on)"

    def allow(self, dt: float) -> float:
        """The largest rate of the object in this step: ``allow.cpp``."""
        _core.allow(self.memory, len(self._cell), dt)
        return self.scalars.allowed

    @property
    def gives(self) -> bool:
        """The grasps give way in the next step, unless a sensor is silent for too long."""
        return gives_way(self.scalars)

    @property
    def aged(self) -> bool:
        """The compliances have to be looked at again."""
        return bool(self.scalars.age >= LOOK_EVERY)

    # -- the wrenches --------------------------------------------------------------------------------------------

    def off_servos(self, commanded: Array, measured: Array) -> Array:
        """Differences of the sensors from the estimate by servos and feed-forward (N, 6).

        Without a payload, the part that an ideal share of some load explains counts as fed forward.
        """
        R = self.look(measured)
        turned = self._chain.twists(pin.difference(self._cell.model, measured, commanded)) @ R
        off = self.holding.to_object @ self.seen.ravel() - servo_wrenches(self._own, turned, self._shared).ravel()
        off *= np.repeat(self.holding.holds, 6)
        carried = self._carried(R) if self.options.palms is None else None  # palms do not carry it yet
        load = off.reshape(-1, 6).sum(axis=0) if carried is None else carried
        return (off - self.holding.load_shares @ load).reshape(-1, 6)

    def _carried(self, R: Array) -> Array | None:
        """The load that the drives carry by feed-forward, in the object frame (6,) [N, N·m]; None if it is not told."""
        payload = self.options.payload
        if payload is None:
            return None
        weight = -payload.mass * R[:3, :3].T @ self._cell.model.gravity.linear
        return np.concatenate([weight, np.cross(payload.centre, weight)])

    def sensor_check(self, q: Array, dt: float) -> SensorCheck | None:
        """The check of the sensors by presses from rest at ``q`` (nq,); None where arms cannot press all ways."""
        o = self.options
        some = len(self._cell) < 2 or not self.holding.everywhere
        if some or not o.presses or o.palms is not None or self.holding.in_part or self._chain.deficient:
            return None
        return SensorCheck(
            self._cell,
            self.holding.grasp,
            softness=self._softness,
            q=q,
            load=self._carried(self.look(q)),
            tolerance=o.sensor_tolerance,
            latest=_LATEST * o.relax_time - dt,
        )

    def look(self, q: Array) -> Array:
        """Look at the compliances at ``q``. Returns blockdiag(R, R) of the object (6, 6)."""
        chain = self._chain
        O, relative = chain.carried(q)[self.holding.first], self.holding.relative
        chain.evaluate(q, about=O.translation)
        R = for_twists(O.rotation)
        C = self._own = R.T @ chain.compliances(self._soft) @ R
        shared = self._shared = chain.shared_compliance(self._soft, R)
        if shared is not None:
            self._compliances[:] = shared.reshape(self._compliances.shape)
        for k, own in enumerate(C):
            self._compliances[k, :, k] = own if shared is None else self._compliances[k, :, k] + own
        if self.holding.in_part:
            self._yields[:] = relative @ yields_in_part(C, self.holding.felt, self.holding.holds, shared)
        else:  # relative @ (blockdiag(C) + shared)
            for k, own in enumerate(C):
                self._yields[:, 6 * k : 6 * k + 6] = relative[:, 6 * k : 6 * k + 6] @ own
            if shared is not None:
                self._yields += relative @ shared
        self.scalars.age = 0.0
        return R

    # -- motion of the grasps ------------------------------------------------------------------------------------

    def press(self, dt: float) -> bool:
        """Move the grasps together until a force is felt, wait for all of it, and learn ρ; true when that is done.

        Forces may grow by themselves, where the object does: how fast is seen before, and is left out.
        """
        o = self.options
        settled = o.delay + 4.0 * o.filter_time + 2.0 * dt
        self._pressing += dt
        felt = self._yields @ self.internal.ravel()
        if self._felt is None:
            self._felt = felt
        if self._pressing <= settled:  # nothing is done yet
            self._grows = (felt - self._felt) / self._pressing
            self._base = self.internal.copy()
            return False
        felt_none = _size(self.internal - self._base) < _PRESS and self._pressed < _PRESS_MOST
        if self._waited == 0.0 and (felt_none or self._pressed < _PRESS_LEAST):
            self._pressed += dt * _PRESS_SPEED
            self.shift += dt * _PRESS_SPEED * self.holding.inward
            return False
        self._waited += dt
        if self._waited <= settled:
            return False
        way = self._pressed * self.holding.inward.ravel()
        answer = felt - self._felt - self._pressing * self._grows
        if way.any():  # some arm minds forces towards the others
            self.scalars.stiffer = self.accepted(answer @ way / (way @ way))
        return True

    def take_stiffness(self, stiffer: float, arms: Array, q: Array) -> None:
        """Take ρ, and by how much each arm is stiffer than that (N,), at the configuration ``q``."""
        self.scalars.stiffer = self.accepted(stiffer)
        own = np.ones(self._cell.nv)
        for columns, much in zip(self._cell.v_slices, arms, strict=True):
            own[columns] = much
        self._soft = self._softness / own
        self.look(q)

    @staticmethod
    def accepted(stiffer: float) -> float:
        """A measured ρ within the range that is answered."""
        return float(np.clip(stiffer, *_STIFFEST))

    def wait_for(self, lost: float | None, dt: float) -> None:
        """Find how long a sensor may be silent, from the share of its samples that it loses at random.

        So many lost samples in a row are silence, and no chance. While the share is not known (None), longer.
        """
        silence = self.options.silent_time
        if lost is None:
            silence *= _SILENT_AT_REST
        elif lost > 0.0:
            silence = max(silence, dt * math.log(_NO_CHANCE) / math.log(min(lost, _MOST_LOST)))
        self.scalars.wrench_silence = silence

    def slow_down(self, delay: float, dt: float) -> bool:
        """Relax no faster than wrenches that come after ``delay`` [s] allow; false if that is too late for any pace."""
        m, slower = self.scalars, max((delay + dt) / (_SLOWED_GAIN * self.options.relax_time), 1.0)
        for name in ("relax_time", "drift_time", "wait_time"):
            setattr(m, name, slower * getattr(m, name))
        return delay <= _TOO_LATE

    def far(self, shift: Array) -> float:
        """The largest shift of a grasp (N, 6), as a share of its reach."""
        far, turned = np.linalg.norm(shift[:, :3], axis=1).max(), np.linalg.norm(shift[:, 3:], axis=1).max()
        return float(max(far / self.options.reach, turned / self.options.turn))

    def found(self, q: Array) -> Array:
        """Where the arms hold the object at ``q``, as a shift of the grasps (N, 6).

        Raises:
            InvalidInputError: that is out of reach.
        """
        O = self._chain.carried(q)
        errors = self._chain.errors(O, O[self.holding.first])
        shift: Array = (self.holding.relative @ errors.ravel()).reshape(-1, 6)
        if self.options.palms is not None:  # they slide, and keep their places
            return shift if self.far(shift) < 1.0 else np.zeros_like(shift)
        if not self.far(shift) < 1.0:
            far, turned = np.linalg.norm(shift[:, :3], axis=1), np.linalg.norm(shift[:, 3:], axis=1)
            o = self.options
            k = int(np.maximum(far / o.reach, turned / o.turn).argmax())
            raise InvalidInputError(
                f"arm {self._cell.arm_names[k]} holds the object {1e3 * far[k]:.1f} mm and "
                f"{math.degrees(turned[k]):.2f}° from its grasp, out of reach ({1e3 * o.reach:g} mm, "
                f"{math.degrees(o.turn):.3g}°)",
                "ForceController.reset: q",
                "Correct the grasp or the base (coopqp calibrate), or give a larger ForceOptions(reach=, turn=).",
            )
        return shift


def yields_in_part(compliances: Array, felt: Array, holds: Holds | None = None, shared: Array | None = None) -> Array:
    """Fᵀ (F G Fᵀ)⁺ F (6 N, 6 N), of the compliances C_k (N, 6, 6) and F (6 N, 6 N) of arms that hold (N,), or all.

    See the module; ``shared`` (6 N, 6 N) is the compliance of joints that arms share, None without any.
    """
    if holds is None or all(holds):
        G = of_grip(compliances, shared)
    else:
        held = np.repeat(holds, 6)
        both = np.ix_(held, held)
        G = np.zeros_like(felt)
        G[both] = of_grip(compliances[list(holds)], None if shared is None else shared[both])
    return felt.T @ np.linalg.pinv(felt @ G @ felt.T, rcond=_LEAST_PART, hermitian=True) @ felt


def _size(wrenches: Array) -> float:
    squares = (wrenches * wrenches).reshape(-1, 2, 3).sum(axis=2).max(axis=0)
    return math.sqrt(max(squares[0], squares[1] / _LENGTH**2))
