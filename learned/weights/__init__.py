"""Weights that ship, and how they are written, checked and read."""

from learned.weights.store import Loaded as Loaded
from learned.weights.store import load_perception as load_perception
from learned.weights.store import load_weights as load_weights
from learned.weights.store import located as located
from learned.weights.store import packaged as packaged
from learned.weights.store import save_weights as save_weights
