"""Study folders: the YAML schema, loading, running, results.

In: `study.yaml` and the files that it names, or options of a command. Out: a `Study`; once it has run, `ledger.sqlite`,
`posterior.nc`, `summary.json`, figures and report, and a `Result` that reads them.
"""

from typing import TYPE_CHECKING

from strandline.foundations.doors import door

if TYPE_CHECKING:
    from strandline.studies.doctor import examine
    from strandline.studies.foresight.check import (
        PosteriorCheck,
        check_posterior,
        finished_posterior,
        offset_band,
        plain_model,
        posterior_digest,
    )
    from strandline.studies.foresight.first_run import (
        early_doubts,
        facing,
        observations_of,
        require_ok,
        require_same_size,
        turned_lines,
    )
    from strandline.studies.foresight.measure_doubts import measure_lines, node_lines
    from strandline.studies.foresight.serve import Solver, served_models
    from strandline.studies.foresight.widths import slopes_by_differences, slopes_by_sensitivities
    from strandline.studies.keys.folder import (
        LEDGER,
        NEXT_LEDGER,
        POSTERIOR,
        REFINEMENT,
        REPLICATES,
        REPORT,
        SPECIMENS_LEDGER,
        SPECIMENS_LINES,
        SPECIMENS_TABLE,
        STUDY,
        SUMMARY,
        digest_of,
        require_temporary,
        require_writable,
        told_if_unwritable,
    )
    from strandline.studies.keys.observation import ObservationFile, StudyNoise
    from strandline.studies.keys.parse import checked, entry, in_words, parse_study, refused_at
    from strandline.studies.keys.schema import Number, Section, listed
    from strandline.studies.keys.study_file import SpecimensFile, StudyFile, WhatIf
    from strandline.studies.keys.template import EXAMPLES, OWN, Observed, write_example
    from strandline.studies.keys.text import REMOVED, changed_text, load_yaml
    from strandline.studies.load.inputs import build_prior, check_complete
    from strandline.studies.load.load import load_study, study_of
    from strandline.studies.load.models import cheaper_dropped, cheaper_lines, differentiating
    from strandline.studies.load.observed import (
        build_noise,
        read_observation,
        read_points,
        require_fits,
    )
    from strandline.studies.load.photographed import (
        UNDEFORMED,
        picture_of,
        reference_of,
        undeformed_picture,
        with_errors_of,
    )
    from strandline.studies.load.progress import (
        RunReported,
        StudyProgress,
        progress_as_planned,
        progress_in,
    )
    from strandline.studies.load.provenance import facts_of, named, points_digest, results_at_hand, versions
    from strandline.studies.load.study import Study, require_study, settled
    from strandline.studies.run import Outcome, Result, load_result, run_study, submit_study
    from strandline.studies.write.changed_copy import changed_study, reuse_from, write_copy
    from strandline.studies.write.export import write_csv, write_netcdf
    from strandline.studies.write.shown import (
        IMAGE,
        PictureFiles,
        picture_behind,
        picture_png,
        read_lines,
        write_page,
        write_pictures,
    )
else:
    __getattr__ = door(__name__, __file__)

__all__ = ["Outcome", "PosteriorCheck", "Result", "Study", "check_posterior", "load_result", "load_study", "run_study"]
