"""Comments behind a print on a page are compared with what it prints."""

import pytest
import torch

from tests.docs.quoted import checking_print, contradictions, quoted
from tests.docs.test_pages import PAGES


@pytest.mark.parametrize(
    ("comment", "values"),
    [
        ("True", (True,)),
        ("True until satellites die", (True,)),
        ("[3, 2]", (torch.zeros(3, 2),)),
        ("[3, 2]", (torch.zeros(3, 2).shape,)),
        ("[4, 12, 21], [4, 12, 10]", (torch.Size([4, 12, 21]), torch.Size([4, 12, 10]))),
        ("[[True, False], [True, False]]", (torch.tensor([[True, False]] * 2),)),
        ("13 and 300 s", (torch.tensor([13.0, 300.0]),)),
        ("40, 15, 30, 1,060 s", (torch.tensor([40.0, 15.0, 30.0, 1060.0]),)),
        ("mrp_1, mrp_2; 60 s each", (["mrp_1", "mrp_2"], torch.tensor([60.0, 60.0]))),
        ("99 and 95 m/s are left", (torch.tensor([98.9, 95.2]),)),
        ("{'agents': ['EO0', ..., 'EO11']}", ({"agents": ["EO0", "EO1", "EO11"]},)),
        ("Box(-1.0, 1.0, (3,), float32)", ("Box(-1.0, 1.0, (3,), float32)",)),
    ],
)
def test_true_and_false_quotations(comment, values):
    assert any(quoted(comment))
    assert not contradictions(comment, values)
    assert contradictions(comment, ("other",))


@pytest.mark.parametrize("comment", ["s since reset, [N]", "drawn at reset", "about 60 m", "paired: the same"])
def test_explanations_quote_nothing(comment):
    assert not any(quoted(comment))


def test_each_number_is_compared_to_the_digits_that_are_quoted():
    assert contradictions("40, 15, 30 s", (torch.tensor([40.0, 15.0, 31.0]),)) == ["30"]
    assert not contradictions("3.1 m", (3.14,))
    assert contradictions("3.2 m", (3.14,)) == ["3.2"]
    assert contradictions("[3, 2]", (torch.zeros(2, 3),)) == ["[3,2]"]


def test_a_wrong_comment_on_a_page_fails(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("print(1 + 1)  # 2\nprint(1 + 1)  # 3\n")
    seen = []
    namespace = {"print": checking_print(page, seen)}
    with pytest.raises(AssertionError, match=r"line 2: \['3'\] of '3'"):
        exec(compile(page.read_text(), str(page), "exec"), namespace)
    assert seen == ["2", "3"]


def test_pages_quote_what_blocks_print():
    comments = [
        line.partition("  # ")[2] for path in PAGES for line in path.read_text().splitlines() if line.startswith(("print(", ")"))
    ]
    assert sum(any(quoted(comment)) for comment in comments) > 25
