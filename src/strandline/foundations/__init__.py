"""What every room stands on: errors, whole files, names and units in text, the registry, threads, compiled kernels.

In: nothing of the product. Out: small tools, each loaded when it is first used.
"""

from typing import TYPE_CHECKING

from strandline.foundations.doors import door

if TYPE_CHECKING:
    from strandline.foundations.computing import (
        WHOLE,
        WIDEST,
        assembled,
        double,
        exp2_of_minus,
        one_thread,
        side_by_side,
        threads,
        use_double,
    )
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
    from strandline.foundations.refusals import (
        content_of,
        imported,
        is_finite,
        keys_of,
        lookup,
        named,
        number,
        numbers,
        of_extra,
        require,
        require_label,
        require_name,
        require_types,
        suggestion,
        unfit,
    )
    from strandline.foundations.text import (
        RAISED,
        decimal,
        figure_text,
        html_table,
        html_text,
        inputs_text,
        is_label,
        is_name,
        listed,
        names_text,
        unit_text,
        with_sd,
    )
    from strandline.foundations.version import __version__
else:
    __getattr__ = door(__name__, __file__)
