"""The learned prior: a small network that has seen how shapes of a category differ."""

from .file import shipped_prior, write_prior
from .learned import Doubts, LearnedPrior, SeenCloud, named_prior
from .view import Frame, Shown, cells_of_maps
