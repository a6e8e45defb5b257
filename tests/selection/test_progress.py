"""What the progress bar says while programs are compiled, and after."""

import time

from manireg._selection.progress import COMPILING, Progress


def test_no_estimate_before_the_first_step_and_then_a_right_one(capsys):
    with Progress(6, "lambdas", show=True) as bar:
        assert COMPILING in capsys.readouterr().err
        time.sleep(1.0)
        bar.step()
        for _ in range(2):
            time.sleep(0.2)
            bar.step()
        rate = bar._bar.format_dict
        left = (rate["total"] - rate["n"]) / ((rate["n"] - 1) / rate["elapsed"])
        assert 0.3 < left < 1.2  # three steps of 0.2 s
    assert "lambdas" in capsys.readouterr().err


def test_silent(capsys):
    with Progress(2, "lambdas", show=False) as bar:
        bar.step()
    assert capsys.readouterr().err == ""
