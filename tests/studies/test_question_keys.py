"""Questions in study.yaml do not make results outdated; everything else in it does."""

import hashlib

import pytest

from strandline.studies.question_keys import digest_of, without_questions

STUDY = "version: 1\nname: a\n# end of the head\n\ninputs:\n  E: {prior: {uniform: [1, 2]}}\n\n# numbers\nseed: 1\n"
INLINE = "next: {V_in: [25, 50]}\n"
BLOCK = "# which rate\nnext:\n  V_in: [25, 50]\n  # and\n  together: 2\n"


@pytest.mark.parametrize("question", [INLINE, BLOCK, "what_if:\n- {fix: {V_in: 2}}\n", "specimens: all/*.csv\n"])
@pytest.mark.parametrize("before", ["inputs:\n", "# numbers\nseed", None])
def test_a_question_added_anywhere_leaves_the_digest_as_it_was(question: str, before: str | None) -> None:
    if before is None:
        asked = STUDY + "\n" + question
    else:
        head, found, tail = STUDY.partition(before)
        assert found
        asked = head + question + "\n" + found + tail
    assert without_questions(asked) == STUDY
    assert digest_of(asked) == hashlib.sha256(STUDY.encode()).hexdigest()


@pytest.mark.parametrize(
    ("old", "new"), [("seed: 1", "seed: 2"), ("[1, 2]", "[1, 3]"), ("# numbers", "# digits"), ("inputs", "next_inputs")]
)
def test_any_other_change_shows(old: str, new: str) -> None:
    assert digest_of(STUDY.replace(old, new) + INLINE) != digest_of(STUDY)


def test_a_study_in_one_flow_mapping_is_kept_whole() -> None:
    text = "{version: 1, next: {V_in: [1]}}\n"
    assert without_questions(text) == text


@pytest.mark.parametrize("text", ["a: [", "a: 1\na: *b\n", "- next\n", "", "[" * 5000])
def test_text_that_is_no_study_is_kept_whole(text: str) -> None:
    assert without_questions(text) == text
