"""Thousands of photographs: in a program of your own, on this machine's processors, or on a cluster.

`estimate` yields what came of each photograph; `Observations` feeds a DataLoader; `run` is `torchlight batch`.
"""

from torchlight.batch.dataset import Observations as Observations
from torchlight.batch.iterate import Found as Found
from torchlight.batch.iterate import estimate as estimate
