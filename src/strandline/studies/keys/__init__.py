"""The keys of study.yaml, version 1, one file per section; its text, checked and changed; the files of its folder."""
