"""SIGTERM and SIGHUP end a command as Ctrl-C does: it cleans up first."""

import contextlib
import signal
import threading
from typing import Any

__all__ = ["Ended", "end_as_ctrl_c"]


class Ended(KeyboardInterrupt):
    """A signal that ends the command; `number` is the signal's number."""

    def __init__(self, number: int) -> None:
        self.number = signal.Signals(number)
        super().__init__(self.number.name)


def end_as_ctrl_c() -> None:
    """Make SIGTERM and SIGHUP raise `Ended` unless they are ignored, as under ``nohup``.

    Only the first signal counts: later ones, such as those when a terminal closes, do not disturb the cleanup.
    """
    if threading.current_thread() is not threading.main_thread():
        return
    for number in _ENDINGS:
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _end)


def _end(number: int, _frame: Any) -> None:
    for each in _ENDINGS:
        with contextlib.suppress(ValueError):
            signal.signal(each, signal.SIG_IGN)
    raise Ended(number)


_ENDINGS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
