"""A participant in a ROS 2 domain, by Cyclone DDS (extra ``ros2``)."""

from __future__ import annotations

import math
import sys
import time
from typing import Any, final

from coopqp.checks import as_count
from coopqp.errors import InvalidInputError
from coopqp.lazy import needed

#: Without this entry another vendor's endpoints are found, and no data pass.
_SETTINGS = "<Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>"
LOCALHOST = (
    '<General><Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    '<MaxAutoParticipantIndex>60</MaxAutoParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery>'
)
#: How many messages are kept until they are read.
KEPT = 10
#: Every state of a reader's messages: read or not, of a known or new writer, alive or not.
_ANYTHING = 0x7F


def require_cyclone() -> None:
    """Raise MissingExtraError if cyclonedds is not installed."""
    needed("cyclonedds", "ros2", "cyclonedds")


def check_topic(topic: Any, name: str, where: str, *, may_be_empty: bool) -> None:
    """Raise InvalidInputError if a topic's name does not begin with ``/``; an empty one may stand for none."""
    if may_be_empty and topic == "":
        return
    if not isinstance(topic, str) or not topic.startswith("/") or len(topic) < 2:
        raise InvalidInputError(f"{name} is {topic!r}", where, "Give a name that begins with /.")


def check_domain(domain: Any, where: str) -> None:
    """Raise InvalidInputError if a ROS_DOMAIN_ID is none."""
    if domain != 0 and as_count(domain, f"{where}: domain") > 232:
        raise InvalidInputError(f"domain is {domain}", where, "Give a number from 0 to 232.")


@final
class Participant:
    """Takes part in a domain, with readers and writers of topics.

    Args:
        domain: ROS_DOMAIN_ID.
        localhost: speak to this machine alone.
    """

    def __init__(self, domain: int, *, localhost: bool) -> None:
        from cyclonedds.domain import Domain, DomainParticipant

        text = _SETTINGS + (LOCALHOST if localhost else "")
        self._domain = Domain(domain, f'<CycloneDDS><Domain id="any">{text}</Domain></CycloneDDS>')
        self._participant = DomainParticipant(domain)

    def _topic(self, name: str, kind: Any) -> Any:
        from cyclonedds.topic import Topic

        return Topic(self._participant, f"rt{name}", kind)  # as ROS 2 calls its topics in DDS

    def reader(self, topic: str, kind: Any) -> Any:
        """A reader of messages; one that is lost is not sent again."""
        from cyclonedds.core import Policy, Qos
        from cyclonedds.sub import DataReader

        qos = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(KEPT))
        return DataReader(self._participant, self._topic(topic, kind), qos=qos)

    def writer(self, topic: str, kind: Any) -> Any:
        """A writer of messages; one that is lost is sent again."""
        from cyclonedds.core import Policy, Qos
        from cyclonedds.pub import DataWriter
        from cyclonedds.util import duration

        qos = Qos(Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.History.KeepLast(KEPT))
        return DataWriter(self._participant, self._topic(topic, kind), qos=qos)

    def waiting(self, reader: Any) -> Any:
        """A wait set, which wakes when the reader has something."""
        from cyclonedds.core import ReadCondition, WaitSet

        found = WaitSet(self._participant)
        found.attach(ReadCondition(reader, _ANYTHING))
        return found


def taken(reader: Any, kind: Any) -> list[Any]:
    """The reader's messages since the last time, without the notices that a peer has gone."""
    return [sample for sample in reader.take(KEPT) if isinstance(sample, kind)]


@final
class OneSender:
    """Lets the messages of one sender of a topic through, the first that is heard. Those of others are counted.

    Args:
        what: what it sends, for the line that is printed once.
        silence: after so long without a message of it another one may follow it [s].
    """

    def __init__(self, what: str, *, silence: float = math.inf) -> None:
        self._what, self._silence = what, silence
        self._sender, self._heard = 0, -math.inf
        self.refused = 0

    def passes(self, sample: Any) -> bool:
        """Whether a message is of this sender."""
        sender, now = int(sample.sample_info.publication_handle), time.monotonic()
        if self._heard == -math.inf or now - self._heard > self._silence:
            self._sender = sender
        if sender == self._sender:
            self._heard = now
            return True
        self.refused += 1
        if self.refused == 1:
            print(f"ROS 2: another sender tells {self._what}, too; it is ignored", file=sys.stderr, flush=True)
        return False
