"""A pair of sockets between a process and its child. They have no port and no name: nobody else can send or listen."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import sys
from collections.abc import Iterator
from typing import final

#: Linux keeps packets whole and tells when the other end is closed; elsewhere a pair of such sockets cannot be made.
_KIND = socket.SOCK_SEQPACKET if sys.platform == "linux" else socket.SOCK_DGRAM
#: Longest packet [bytes].
_LONGEST = 65536


@final
class PacketEnd:
    """One end of a pair of connected sockets, which passes packets on in their order and never waits.

    Args:
        link: the socket.
    """

    def __init__(self, link: socket.socket) -> None:
        link.setblocking(False)
        self._link = link

    @classmethod
    def pair(cls) -> tuple[PacketEnd, PacketEnd]:
        """Two ends. A child gets its own by ``pass_fds``, and then this process closes that one."""
        one, other = socket.socketpair(socket.AF_UNIX, _KIND)
        return cls(one), cls(other)

    @classmethod
    def inherited(cls, number: int) -> PacketEnd:
        """The end that this process got from its parent; programs that it starts do not get it."""
        os.set_inheritable(number, False)
        return cls(socket.socket(fileno=number))

    def fileno(self) -> int:
        """Its number for the operating system."""
        return self._link.fileno()

    def send(self, packet: bytes) -> None:
        """Send a packet; it is lost if the other end has no room or is closed."""
        with contextlib.suppress(OSError):
            self._link.send(packet)

    def waits(self, longest: float) -> bool:
        """Wait for a packet, or for the other end to be closed, for ``longest`` [s] at most; whether there is one."""
        return bool(select.select([self._link], [], [], longest)[0])

    def first(self) -> bytes:
        """The packet that comes next, which stays; empty if the other end is closed."""
        return self._link.recv(_LONGEST, socket.MSG_PEEK)

    def packets(self) -> Iterator[bytes]:
        """The packets that have come.

        Raises:
            EOFError: the other end is closed, and all its packets were taken.
        """
        while True:
            try:
                packet = self._link.recv(_LONGEST)
            except BlockingIOError:  # nothing more has come
                return
            except OSError as error:
                raise EOFError from error
            if not packet:
                raise EOFError
            yield packet

    def close(self) -> None:
        """Give the socket back."""
        self._link.close()
