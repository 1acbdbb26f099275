"""What every room stands on: errors, whole files, names and units in text, the registry, threads, compiled kernels.

In: nothing of the product. Out: small tools, each loaded when it is first used.
"""

from typing import TYPE_CHECKING

from strandline.foundations.doors import door

if TYPE_CHECKING:
    from strandline.foundations.compiled import WHOLE, WIDEST, ample, assembled, exp2_of_minus
    from strandline.foundations.errors import (
        CampaignStopped,
        ForwardModelError,
        InvalidInput,
        InvalidInterface,
        InvalidStudy,
        LedgerError,
        NoCommonPoints,
        NumericsError,
        ResultsNotWritten,
        StrandlineError,
        TooFewRuns,
    )
    from strandline.foundations.files import end_of, how_it_ended, read_json, whole_file, write_json
    from strandline.foundations.linear_algebra import distances, factorise, invert, solve
    from strandline.foundations.registry import imported, lookup, of_extra, suggestion
    from strandline.foundations.text import decimal, is_label, is_name, listed, require_label, require_name, with_sd
    from strandline.foundations.thread_pool import double, one_thread, side_by_side, threads, use_double
    from strandline.foundations.typeset import RAISED, figure_text, html_table, html_text, unit_text
    from strandline.foundations.version import __version__
else:
    __getattr__ = door(__name__, __file__)
