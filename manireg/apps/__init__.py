"""What a field asks for, in its words: each a few lines around `fit` and its posterior."""

from ._path import PolePath as PolePath, path as path
from ._poles import Poles as Poles
