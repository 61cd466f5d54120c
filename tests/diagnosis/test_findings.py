"""Findings are data, and say in words what they are."""

import string

import pytest

from tso_cli.diagnosis.assumptions import INVERTED
from tso_cli.diagnosis.findings import NOTES, SUSPICIOUS_SYMPTOMS, SYMPTOMS, Finding
from tso_cli.diagnosis.hypotheses import HYPOTHESES


@pytest.mark.parametrize(
    ("finding", "words"),
    [
        (Finding("opengl", (0,)), "the camera's axes are OpenGL's (y up, z backward) (view 0)"),
        (
            Finding("mask-inverted", (1,), 0.71, 0.55, without=INVERTED),
            "the assumption mask-inverted is wrong (view 1): IoU 0.71, +0.55",
        ),
        (
            Finding("mispaired", (0, 1), 0.8, 0.3, pairs=((1, 0), (0, 1))),
            "masks and cameras are paired wrongly (views 0, 1): IoU 0.80, +0.30",
        ),
        (
            Finding("outliers", values={"count": 1234}),
            "points far from the rest stay where they are, and no measure counts them "
            "(found 1,234)",
        ),
    ],
)
def test_a_finding_in_words(finding, words):
    assert str(finding) == words


@pytest.mark.parametrize(
    ("names", "suspicious"), [(HYPOTHESES, True), (SUSPICIOUS_SYMPTOMS, True), (NOTES, False)]
)
def test_what_makes_a_result_doubtful(names, suspicious):
    assert all(Finding(name).suspicious == suspicious for name in names)


def test_no_name_has_two_meanings_and_no_words_name_an_option():
    assert not set(HYPOTHESES) & set(SYMPTOMS)
    words = [*SYMPTOMS.values(), *(hypothesis.says for hypothesis in HYPOTHESES.values())]
    assert not any("--" in text for text in words)


@pytest.mark.parametrize("name", SYMPTOMS)
def test_the_words_of_a_symptom_need_no_more_than_its_values(name):
    values = {field: 1.5 for _, field, _, _ in string.Formatter().parse(SYMPTOMS[name]) if field}
    assert "{" not in Finding(name, values=values).says
