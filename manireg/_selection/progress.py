"""A progress bar that tells the truth: the first of equal steps compiles what all of them
use, so it says nothing of how long the others take."""

from tqdm.auto import tqdm

COMPILING = "compiling (once for problems of this size)"


class Progress:
    """Shows no estimate before the first step is done, then one made of the others."""

    def __init__(self, steps: int, what: str, show: bool):
        self._steps, self._what = steps, what
        self._bar = tqdm(total=steps, bar_format=COMPILING, disable=not show)

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *_) -> None:
        self._bar.close()

    def step(self) -> None:
        """One more is done."""
        bar = self._bar
        if bar.disable:
            return
        if bar.bar_format == COMPILING:
            bar.bar_format = None
            bar.reset(self._steps)
            bar.set_description(self._what, refresh=False)
            bar.initial = 1
        bar.update()
