import numpy as np
import pytest

from learned.pictures.reward_figure import paper_reward_terms
from learned.rewards import PAPER_SAG
from tests.pictures.layout import cut_texts, laid_out, overlapping_texts, texts_on_data


def test_the_figure_has_the_terms_of_the_paper_with_the_values_of_its_formulas(tmp_path):
    figure = paper_reward_terms(tmp_path / "terms.png")
    drawn = {axes.get_title(): axes.lines[-1].get_xydata().T for axes in figure.axes}
    assert set(drawn) == set(PAPER_SAG)
    expected = {
        "step": (0.1, 0.01), "goal": (0.1, 0.0), "distance": (0.06, 0.002),
        "sag": (0.0, -0.7 * np.tanh(0.09) - 0.035), "action_ratio": (5.0, -0.1),
        "deviation": (3.0, -0.2),
    }  # fmt: skip
    for name, (variable, term) in expected.items():
        assert np.interp(variable, *drawn[name]) == pytest.approx(term, abs=5e-3)
    distance, goal = drawn["goal"]
    assert distance[goal > 0.5].max() == pytest.approx(0.05, abs=1e-3)


def test_nothing_in_the_figure_is_cut_off_or_covered(tmp_path):
    figure = laid_out(paper_reward_terms(tmp_path / "terms.png"))
    assert cut_texts(figure) == overlapping_texts(figure) == texts_on_data(figure) == []
