"""The progress line: rewritten on a terminal, plain lines elsewhere, and never too often."""

import io

from jaxwillmore.evolve import TextProgressMeter, progress_text

RECORD = {
    "step": 3, "t": 0.25, "dt": 1e-3, "energy": 25.2, "area": 12.5,
    "min_angle": 40.0, "rejected_steps": 1,
}  # fmt: skip


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_terminal_has_one_line_that_is_rewritten():
    out = Terminal()
    meter = TextProgressMeter(out, interval=0.0)
    for line in ("a long line", "short"):
        meter.update(line)
    meter.close()
    assert out.getvalue() == "\ra long line\rshort      \n"


def test_a_file_has_plain_lines_not_too_often():
    out = io.StringIO()
    meter = TextProgressMeter(out, interval=1e6)
    meter.show("start")
    for line in ("one", "two"):
        meter.update(line)
    meter.close()
    assert out.getvalue() == "start\none\n"


def test_the_line_says_where_the_run_is():
    text = progress_text(RECORD, 5.0)
    assert "step     3" in text and "t 0.25 of 5" in text and "rejected 1" in text
    assert "of" not in progress_text(RECORD)
