"""Options that executors share, and their checks."""

import re

from strandline.errors import InvalidInput

SPARE_SECONDS = 60.0
"""Part of its walltime that a job needs before and after a run."""
LONGEST_TIMEOUT = 366 * 24 * 3600.0
"""Seconds; longer times overflow clocks and pipes."""
DAYS = re.compile(r"(?P<days>\d+)-(?P<hours>\d+)(:(?P<minutes>\d+))?(:(?P<seconds>\d+))?")
CLOCK = re.compile(r"((?P<hours>\d+):)?(?P<minutes>\d+):(?P<seconds>\d+)")


def require_count(what: str, value: int | None, *, remedy: str, least: int = 1) -> None:
    """Refuse a number below `least`; None is left to the executor."""
    if value is not None and value < least:
        raise InvalidInput(what, value=value, expected=f"at least {least}", remedy=remedy)


def require_timeout(timeout: float | None) -> None:
    """Refuse a timeout that is not above 0, or longer than a year."""
    if timeout is not None and not 0 < timeout <= LONGEST_TIMEOUT:
        raise InvalidInput(
            "timeout",
            value=timeout,
            expected=f"seconds above 0, at most {LONGEST_TIMEOUT:.0f} (a year)",
            remedy="Leave it out for no limit.",
        )


def require_room_in_walltime(timeout: float | None, walltime: str | None) -> None:
    """Refuse a timeout longer than the job of a run may last: the run would be killed and tried again and again."""
    if timeout is None or walltime is None:
        return
    longest = walltime_seconds(walltime) - SPARE_SECONDS
    if timeout > longest:
        raise InvalidInput(
            "timeout and walltime of a job",
            value=f"{timeout:g} s in a job of {walltime}",
            expected=f"at most {max(longest, 0.0):g} s, the walltime less {SPARE_SECONDS:g} s for start and end",
            remedy="Ask for a longer walltime, or shorten the timeout.",
        )


def walltime_seconds(text: str) -> float:
    """Return the seconds of a walltime as SLURM writes it: MM:SS, HH:MM:SS, D-HH, D-HH:MM or D-HH:MM:SS.

    Raises:
        InvalidInput: It is none of these; a bare number is refused, since SLURM and PBS differ in its unit.
    """
    found = DAYS.fullmatch(text) or CLOCK.fullmatch(text)
    if found is None:
        raise InvalidInput(
            "walltime",
            value=text,
            expected='hours:minutes:seconds, e.g. "02:30:00", or days-hours, e.g. "1-12"',
            remedy="Write it like this, in quotes.",
        )
    parts = {name: int(number or 0) for name, number in found.groupdict().items()}
    hours = 24 * parts.get("days", 0) + parts["hours"]
    return 3600.0 * hours + 60.0 * parts["minutes"] + parts["seconds"]
