"""Figures of streams."""

import erosion
from erosion.distributions import Normal
from erosion.plotting.maps import plot_stream


def test_errors_and_bands_say_that_they_are_by_sampling_alone():
    result = erosion.stream("linearized", erosion.TABLE_1, alpha=Normal(0.5, 0.05), n=256)
    rows = result.rows()
    assert "± is the error by sampling these particles alone, all other parameters taken as exact" in rows[0].meaning
    assert [row.meaning for row in rows if "95 % interval" in row.meaning] == ["its 95 % interval, by sampling alone"]
    (legend,) = plot_stream(result).legends
    texts = [text.get_text() for text in legend.get_texts()]
    assert sum("sampling alone" in text for text in texts) == 2
    assert not any(text == "95 % band" for text in texts)
