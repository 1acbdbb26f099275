"""The keys of study.yaml, version 1, one file per section: what each key means, and which values it takes."""

from strandline.studies.keys.schema import annotation_of, keys_within
from strandline.studies.keys.study_file import SCHEMA_VERSION, StudyFile

__all__ = ["SCHEMA_VERSION", "StudyFile", "annotation_of", "keys_within"]
