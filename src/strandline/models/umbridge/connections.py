"""The connections that a server has open: a bounded number, none of them silent for long."""

import contextlib
import socket
import threading
import time

__all__ = ["Connections"]

SOON_SECONDS = 0.5
"""A connection that has just been made gets this long before it can be ended in favour of a new one."""


class Connections:
    """Counts connections; each is waiting for a request or working on one.

    When all places are taken, a new connection replaces the one that has waited longest for its client. Those that are
    working are never ended.

    Args:
        most: Number of places.
        patience: Seconds within which a client must send a whole request.
    """

    def __init__(self, most: int, patience: float) -> None:
        self._patience = patience
        self._free = threading.BoundedSemaphore(most)
        self._lock = threading.Lock()
        self._waiting: dict[socket.socket, float] = {}

    def admit(self, connection: socket.socket) -> bool:
        """Give a new connection a place; return whether there is one."""
        for _ in range(2):  # after the first round those that have just been made may be ended too
            if self._free.acquire(blocking=False):
                break
            self._end_older_than(SOON_SECONDS, most=1)
            if self._free.acquire(timeout=SOON_SECONDS):
                break
        else:
            return False
        self.waits(connection)
        return True

    def leave(self, connection: socket.socket) -> None:
        """Free the place of a connection that has been admitted."""
        self.works(connection)
        self._free.release()

    def waits(self, connection: socket.socket) -> None:
        """Note that the connection waits for its client's next request, from now on."""
        with self._lock:
            self._waiting[connection] = time.monotonic()

    def works(self, connection: socket.socket) -> None:
        """Note that the client has sent its request."""
        with self._lock:
            self._waiting.pop(connection, None)

    def end_overdue(self) -> None:
        """End the connections whose client has not sent a whole request in time, even if it keeps sending slowly."""
        self._end_older_than(self._patience)

    def _end_older_than(self, seconds: float, *, most: int | None = None) -> None:
        limit = time.monotonic() - seconds
        with self._lock:  # oldest first: the dictionary keeps the order, and `waits` may only refresh
            found = sorted((since, n, c) for n, (c, since) in enumerate(self._waiting.items()) if since <= limit)
            for _, _, connection in found[:most]:
                with contextlib.suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)
