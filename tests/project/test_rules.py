"""The picture of how many words are answered, by the rule that answers them."""

from xml.etree import ElementTree

from benchmarks.suite.chart import Line, Mark, curves


def test_curves_name_their_lines_and_marks():
    drawn = curves("Title", "x", "y", [Line("ours", [100, 0], [100, 50], [Mark("sure", 0, 50)]), Line("b", [0], [0])])
    texts = [one.text for one in ElementTree.fromstring(drawn).iter() if one.tag.endswith("text")]
    assert {"Title", "ours", "b", "sure", "x", "y"} <= {*texts}
    assert drawn.count("<polyline") == 2
    assert drawn.count("<circle") == 1
