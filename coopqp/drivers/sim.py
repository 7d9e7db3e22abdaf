"""The driver ``sim``: a simulated robot in a process of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, final

from coopqp.checks import ArrayLike, Doc, as_options, as_seed, as_vector, documented, keep_scalars
from coopqp.drivers.driver import Condition
from coopqp.drivers.packets import pack_order
from coopqp.drivers.process_link import ProcessDriver
from coopqp.errors import InvalidInputError

#: Longest start of the robot's process [s].
_START = 30.0


@documented
@dataclass(frozen=True, kw_only=True)
class SimOptions:
    """Settings of a simulated robot and of its link."""

    period: Annotated[float, Doc("time between two states [s]")] = 0.002
    lag: Annotated[float, Doc("first-order lag of its joints [s]")] = 0.01
    delay: Annotated[float, Doc("time until a command has an effect, beside the lag [s]")] = 0.0
    tells_lag: Annotated[bool, Doc("the driver tells the lag; else the loop learns it")] = True
    tells_target: Annotated[bool, Doc("the robot tells what its servos track")] = True
    latency: Annotated[float, Doc("least age of a packet when it arrives [s]")] = 0.0
    jitter: Annotated[float, Doc("largest further age of a packet [s]")] = 0.0
    loss: Annotated[float, Doc("share of the packets that never arrive")] = 0.0
    clock_offset: Annotated[float, Doc("what its clock shows when its process begins [s]")] = 0.0
    seed: Annotated[int, Doc("seed of jitter and losses")] = 0

    def __post_init__(self) -> None:
        keep_scalars(self, "period", high=1.0)
        keep_scalars(self, "lag", "delay", "latency", "jitter", high=1.0, open_low=False)
        keep_scalars(self, "loss", high=0.9, open_low=False)
        object.__setattr__(self, "seed", as_seed(self.seed, "SimOptions"))


@final
class SimDriver(ProcessDriver):
    """A simulated robot. Its process begins with :meth:`connect` and ends with :meth:`close`, or with this program.

    Args:
        joint_names: names of its joints.
        q: where it stands (n,) [rad or m].
        options: settings, or a dictionary of them.
    """

    def __init__(self, joint_names: Sequence[str], q: ArrayLike, options: Any = None) -> None:
        names = tuple(joint_names)
        if not names:
            raise InvalidInputError("no joints", "SimDriver", "Give their names.")
        o = self.options = as_options(SimOptions, options, "SimDriver: options")
        settings = {name: getattr(o, name) for name in o.__dataclass_fields__}
        settings["q"] = as_vector(q, len(names), "SimDriver: q").tolist()
        super().__init__(names, "coopqp.drivers.sim_process", settings, start=_START)
        self.period, self.delay = o.period, o.delay
        self.lag: float | None = o.lag if o.tells_lag else None

    # -- what may happen to a robot --------------------------------------------------------------------------------

    def halt(self, *, says: Condition = Condition.RUNNING) -> None:
        """The robot stands from now on, and says so or not."""
        self._link.tell(pack_order("halt", says=says.value))

    def release(self) -> None:
        """The robot follows its commands again."""
        self._link.tell(pack_order("release"))

    def limit(self, speed: float | None) -> None:
        """The robot moves at this speed at most (norm of the joints' velocities) [rad/s]; None without a limit."""
        self._link.tell(pack_order("limit", speed=speed))

    def close(self) -> None:
        """End the robot's process, and give its socket back."""
        self._link.close()
