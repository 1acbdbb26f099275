"""The keys of study.yaml, version 1, one file per section; its text, checked and changed; the files of its folder."""

from typing import TYPE_CHECKING

from strandline.foundations.doors import door

if TYPE_CHECKING:
    from strandline.studies.keys.schema import annotation_of, keys_within
    from strandline.studies.keys.study_file import SCHEMA_VERSION, StudyFile
else:
    __getattr__ = door(__name__, __file__)

__all__ = ["SCHEMA_VERSION", "StudyFile", "annotation_of", "keys_within"]
