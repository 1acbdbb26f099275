"""Upgrade a ledger of strandline 0.1, or of versions before 0.2: ``python -m verification.upgrade_ledger LEDGER``.

Version 2 added the table of arrays, version 3 plans and an index, version 4 runs excluded by hand. All rows stay as
they are. A copy is made first, ``ledger.sqlite.v3-backup``.
"""

import sqlite3
import sys
from contextlib import closing
from itertools import count
from pathlib import Path

from strandline.runs.ledger.ledger_schema import GUARDS, TABLES, VERSION, copied


def upgrade(path: Path) -> Path:
    """Upgrade the ledger at `path` in one transaction, and return its copy."""
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        (version,) = connection.execute("SELECT value FROM meta WHERE key = 'schema_version'").fetchone()
        names = (path.with_name(f"{path.name}.v{version}-backup{f'-{k}' if k else ''}") for k in count())
        backup = next(name for name in names if not name.exists())
        copied(connection, backup)
        missing = TABLES + GUARDS
        for kind in ("TABLE", "INDEX", "TRIGGER"):
            missing = missing.replace(f"CREATE {kind} ", f"CREATE {kind} IF NOT EXISTS ")
        missing = missing.replace("CREATE UNIQUE INDEX ", "CREATE UNIQUE INDEX IF NOT EXISTS ")
        facts = f"UPDATE meta SET value = '{VERSION}' WHERE key = 'schema_version';"
        connection.executescript(f"BEGIN IMMEDIATE;\n{missing}{facts}\nCOMMIT;")
    return backup


if __name__ == "__main__":
    print(f"upgraded; the ledger as it was is {upgrade(Path(sys.argv[1]))}")
