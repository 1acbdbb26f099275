"""Questions about a finished study: what next, which model, how many specimens, what if, are its intervals right?

In: a study with results. Out: an `Answer` (sentence, table, content, figures), and runs in a ledger of its own if it
needs some. The study's own results stay as they are.
"""

from typing import TYPE_CHECKING

from strandline.foundations.doors import door

if TYPE_CHECKING:
    from strandline.foundations import require
    from strandline.questions.compare import odds_in
    from strandline.questions.knowledge import baseline_of, field_knowledge
    from strandline.questions.many import RefusedSpecimen
    from strandline.questions.specimens import watch_specimens
else:
    __getattr__ = door(__name__, __file__)
